"""Friction laws, and their linearisation and equivalent damping."""
