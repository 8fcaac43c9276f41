"""Images, sound and sessions with the panel."""
