"""Pictures over spindle speed and depth of cut."""
