"""Causes seen in cuts."""
