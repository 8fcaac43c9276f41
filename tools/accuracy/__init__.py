"""Accuracy of every step: `python -m tools.accuracy NAME [options]` repeats a figure of the documents."""
