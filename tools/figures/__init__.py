"""The README's figures: `python -m tools.figures picture|curves|tables`."""
