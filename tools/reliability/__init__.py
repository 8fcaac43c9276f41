"""Judges of the verdict of `smooth`: set-up errors, and unusual set-ups of a second simulator."""
