"""Lever arms, lengths and mounting from ordinary recordings."""
