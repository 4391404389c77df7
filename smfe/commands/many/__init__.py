"""`smfe run` of many campaigns, and the catalogue of what they found."""
