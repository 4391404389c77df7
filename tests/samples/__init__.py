"""Results made for the tests of the report."""
