"""From a campaign to what is put to the test."""
