"""A recovery in the formats of other programs."""
