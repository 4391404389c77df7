"""Inertial actuator and shaker: stepped sine, periodic and random forces."""
