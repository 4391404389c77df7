"""Compliances compared: peaks, matched differences, and which conditions explain them."""
