"""One table of what many campaigns found: its columns, its rows, and what can be said of a machine or a fleet by it."""
