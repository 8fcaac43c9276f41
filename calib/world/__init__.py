"""Camera to base IMU to world (JA II-F.2): what keeps the camera's tilt through every recording after it.

The method on one page is `world_calibration.py`; `world_table.py` applies its answer to a recording.
"""
