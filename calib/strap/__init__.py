"""Where the IMU's strap is in images of the forearm."""
