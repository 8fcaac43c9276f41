"""Calibrations of the rig: extrinsics, IMU, forearm, clocks; kept in one file."""

from .file import CalibrationFile, read_calibration, write_calibration

__all__ = ["CalibrationFile", "read_calibration", "write_calibration"]
