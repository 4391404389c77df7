"""The machine: modes, structure, joints, operating point."""
