"""Traces of machine controls."""
