"""Measurements made ready: inertial signal, attitude, clocks, visibility, outliers."""
