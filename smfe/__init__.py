"""The measured side and the composition."""
