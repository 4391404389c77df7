"""Sweep milling force excitation (SMFE): the cutting force as the excitation."""
