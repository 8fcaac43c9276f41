"""Where the further cameras of a set-up stand, found once and kept as a prior."""
