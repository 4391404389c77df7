"""From the uncertainty of a compliance to that of a limiting depth of cut."""
