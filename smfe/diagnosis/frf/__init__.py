"""Causes seen in compliances."""
