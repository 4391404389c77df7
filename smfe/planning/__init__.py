"""Which sweep to cut."""
