"""The machine and the cut."""
