"""What a recorder makes of a signal: sensors, their stages, trials."""
