"""Nested models, likelihood ratios, cross-validation: knows no machine tool."""
