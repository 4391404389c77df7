"""Errors of the sweep estimators, as tables."""
