"""A finding as an engineer tells it: sentences, what to do next, and what was measured beside what both models say."""
