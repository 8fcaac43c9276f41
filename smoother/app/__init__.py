"""The local page: `unocclude app` serves it to this computer's browser alone."""
