"""Spectra, periods, tones, spindle angle."""
