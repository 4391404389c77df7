"""Uncertainty of a compliance: intervals, covariance, differences."""
