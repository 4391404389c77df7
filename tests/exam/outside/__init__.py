"""Exams on records that others made: nothing of theirs is kept here, and each exam says why where they are absent."""
