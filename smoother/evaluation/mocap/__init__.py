"""Motion capture as a truth: its markers, its clock, its frame."""
