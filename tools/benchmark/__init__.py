"""How fast and how big: `python -m tools.benchmark`."""
