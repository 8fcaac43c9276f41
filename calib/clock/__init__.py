"""Clocks against each other: beeps, broadcasts, motion."""
