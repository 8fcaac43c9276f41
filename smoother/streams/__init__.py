"""A session while it lasts: streams in, the arm's motion out, everything recorded."""
