"""How fast, how big, how exact, and beside what: `python -m tools.benchmark`."""
