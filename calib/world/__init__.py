"""Camera to base IMU to world (JA II-F.2): what keeps the camera's tilt through every recording after it.

The method on one page is `calibrate.py`; `apply.py` takes its answer to a recording.
"""
