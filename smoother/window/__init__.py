"""A window as plain arrays: cut from a segment, told priors, joined to a trajectory."""
