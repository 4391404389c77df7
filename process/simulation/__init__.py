"""Time simulation: the milling process on modes, and the machine in motion."""
