"""Recordings as devices and camera programs write them: one importer, one file."""
