"""Gains of the feed drives for the most stable cut."""
