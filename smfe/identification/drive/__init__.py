"""Feed drive: control loops, friction, inertia (section 5.1 of the paper)."""
