"""Verbs that ask about the cut of one `[[lobes]]`: its pitch, its vibration."""
