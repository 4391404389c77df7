"""The commands of the command line as functions, one a file."""
