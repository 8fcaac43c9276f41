"""The marker panel: where it stands before the camera, and camera to mocap (JA II-F.1).

The method on one page is `calibrate.py`: bright spots, which is which, regions without markers, plane, the
panel's axes as published, and one factor graph over all poses.
"""
