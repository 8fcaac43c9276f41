"""What the live smoother can say at the moment."""

from __future__ import annotations

from enum import StrEnum


class LiveState(StrEnum):
    """Whether there is an answer, and what it rests on."""

    CALIBRATING = "calibrating"  # no answer yet, never a guess; until the first calibration has caught up
    VISIBLE = "visible"
    GAP = "gap"  # the camera does not see the forearm: the IMU and the upper arm's length go on
    LOST = "lost"  # the IMU stopped, or there is too much to catch up with: no answer until then
