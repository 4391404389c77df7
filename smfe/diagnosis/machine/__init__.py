"""Diagnosis of a machine of several feed axes: drives, guideways and modes of one structure, at rest and in motion."""
