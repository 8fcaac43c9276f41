"""A window as plain arrays: cut from a segment, given priors, joined to a trajectory."""
