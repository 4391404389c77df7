"""What stands behind `stability.operating_point`: vibrations of a machine in a cut, compliances over conditions."""
