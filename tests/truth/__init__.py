"""Independent simulators: they share no model code with the packages."""
