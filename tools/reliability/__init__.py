"""Judges of the verdict of `smooth`: set-up errors, and unusual set-ups.

The unusual ones come from a second simulator, written apart from `smoother.simulation`: `cases`, `scene`,
`motions`, `body`. `python -m tools.accuracy oracle` counts them.
"""
