"""Faults of streams fed into the live smoother: for how long is it wrong beyond what it states?"""
