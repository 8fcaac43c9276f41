"""A wrong convention of the camera's axes is said, with the right one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from smoother.recording import CameraFrame
from smoother.recovery.trust import _gravity


def sentences(gravity: np.ndarray, frame: CameraFrame | None, hint: np.ndarray | None = None) -> list[str]:
    recovery = SimpleNamespace(gravity_direction=gravity)
    recording = SimpleNamespace(camera_frame=frame, gravity_hint=hint)
    return list(_gravity(recovery, recording))  # type: ignore[arg-type]


@pytest.mark.parametrize("right", CameraFrame)
@pytest.mark.parametrize("stated", CameraFrame)
def test_every_frame_taken_for_every_other(right: CameraFrame, stated: CameraFrame):
    tilted = right.down + 0.3 * np.array([0.5, 0.4, 0.6])  # a camera that looks down a little
    said = sentences(tilted / np.linalg.norm(tilted), stated)
    if right is stated:
        assert said == []
    else:
        assert len(said) == 1 and said[0].endswith(f"gravity fits the frame {right} instead of {stated}")


def test_axes_of_no_frame_and_a_given_direction():
    assert sentences(np.array([1.0, 0.0, 0.0]), CameraFrame.KINECT)[0].endswith(
        "down is about x of the positions"
    )
    up = np.array([0.0, -1.0, 0.0])
    (said,) = sentences(up, None, np.array([0.0, 1.0, 0.0]))
    assert said.endswith("down is about -y of the positions")
    assert sentences(np.full(3, np.nan), CameraFrame.KINECT) == [] == sentences(up, None)
