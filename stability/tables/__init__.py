"""Lobe tables, pockets, presets."""
