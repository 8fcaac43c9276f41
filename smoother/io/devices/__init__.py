"""Recordings as devices and camera programs write them: what recognises, reads and joins them."""
