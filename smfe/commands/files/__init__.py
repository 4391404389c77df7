"""Verbs about files: look, convert, export; `smfe.cli.files` parses their arguments."""
