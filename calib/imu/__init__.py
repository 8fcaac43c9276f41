"""What is measured once of an inertial sensor: accelerometer, gyroscope, noise, magnetometer."""
