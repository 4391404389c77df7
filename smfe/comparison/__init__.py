"""Methods beside each other: peaks, differences, and what explains them."""
