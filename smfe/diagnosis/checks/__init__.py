"""Faults in data."""
