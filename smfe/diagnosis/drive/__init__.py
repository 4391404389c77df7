"""Causes seen in drive records."""
