"""Stability methods, one a file: zero order, multi-frequency, semi-discretization."""
