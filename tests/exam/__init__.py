"""Exams: hidden effects and records that nobody prepared, scored."""
