"""What the simulation gets wrong: causes, evidence, gain."""
