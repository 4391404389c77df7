"""Diagnosis of one feed axis by all evidence: hits at rest and in motion, drive records, limits of cutting tests."""
