"""The marker panel: its pose in the camera frame, and camera to mocap (JA II-F.1).

The method on one page is `panel_calibration.py`: bright spots, which is which, regions without markers, a
plane, the panel's axes as published, and one factor graph over all poses.
"""
