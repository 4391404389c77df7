"""The feed drive and its control: servo, sampled servo, axis (Eq. 2 to 5 of the paper), poles with dead time."""
