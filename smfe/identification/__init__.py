"""Records -> compliance with uncertainty (section 3 of the paper), a room a method."""
