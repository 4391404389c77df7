"""Where tests find what is not theirs: the checkout, its data sets, and public measurements that lie beside it."""

import os
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
DATASETS = CHECKOUT / "datasets"
DATA = Path(os.environ.get("SMFE_DATA") or CHECKOUT.parent / "shared" / "data")
"""Measurements by others; tests that need them skip where it is missing."""
