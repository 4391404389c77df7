"""Friction laws, and what they are worth as a damping."""
