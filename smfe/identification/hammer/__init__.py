"""Impact hammer: impacts, windows, background, direction."""
