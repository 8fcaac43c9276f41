"""The recovery of a recording: sections, two passes, one trajectory."""
