"""Sensors, their stages, and virtual trials on a simulated machine."""
