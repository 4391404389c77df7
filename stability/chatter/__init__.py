"""The spectral chatter criterion: amplitudes at the tooth passing orders and beside them."""
