"""Lobes that a campaign asks for, and cutting tests beside them."""
