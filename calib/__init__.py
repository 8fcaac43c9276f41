"""Calibrations of the rig: extrinsics, IMU, forearm, clocks; kept in one file."""
