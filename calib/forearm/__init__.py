"""Lever arms, lengths and mounting from a held pose."""
