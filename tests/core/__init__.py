"""Tests of the smoother's core."""
