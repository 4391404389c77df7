"""The cut: tool, engagement, cutting force."""
