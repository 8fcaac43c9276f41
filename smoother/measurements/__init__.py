"""What was measured, made ready: inertial signal, attitude, clocks, what is visible, outliers."""
