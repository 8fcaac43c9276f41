"""Markers of motion capture, from TRC, C3D and tables."""
