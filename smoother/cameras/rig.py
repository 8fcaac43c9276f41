"""The cameras of a recording as a table: a row each, the first one's first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..array_types import FloatArray
from ..recording import JOINTS, CameraPose


@dataclass(frozen=True)
class RelativeClock:
    """t_first = t_own + offset, which may drift."""

    offset_s: float = 0.0  # At the time `middle_s`
    skew: float = 0.0  # Steady drift
    middle_s: float = 0.0  # On the camera's own clock
    sigma_s: float = 0.0  # One standard deviation of the offset

    def to_first(self, t: FloatArray) -> FloatArray:
        """Own times (n,) on the first camera's clock, s."""
        return t + self.offset_s + self.skew * (t - self.middle_s)

    def from_first(self, t: FloatArray) -> FloatArray:
        """The other way round."""
        return self.middle_s + (t - self.offset_s - self.middle_s) / (1.0 + self.skew)


@dataclass(frozen=True)
class RigCamera:
    """A camera of a recording, where it stands, and its clock."""

    name: str
    pose: CameraPose | None = None  # In the first camera's frame; None where it could not be found
    clock: RelativeClock = field(default_factory=RelativeClock)  # Against the first camera's
    # (5, 3) m: How far its joints lie from the first camera's, in {K}, beyond its pose
    joint_offset_m: FloatArray = field(default_factory=lambda: np.zeros((len(JOINTS), 3)))
    # Median distance between its joints and the first camera's, all that is constant taken off
    misfit_m: float = float("nan")
    together_s: float = float("nan")  # Time during which both saw some part of the arm
    reason: str = ""  # Why it was left out; "" where it is used
    note: str = ""  # What is to be known of one that is used, after its name
    # On the first camera's clock, between when it or the first one was moved
    moved_s: tuple[float, float] | None = None

    @property
    def takes_part(self) -> bool:
        """It is one of the cameras of the answer."""
        return not self.reason


def first_camera(name: str) -> RigCamera:
    """The camera in whose frame results stand."""
    return RigCamera(name, CameraPose(np.eye(3), np.zeros(3), 0.0, 0.0), misfit_m=0.0)


@dataclass(frozen=True)
class CameraRig:
    """All cameras of a recording."""

    cameras: tuple[RigCamera, ...]  # The first one, then the further ones in their order

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def used(self) -> tuple[RigCamera, ...]:
        """Those that are used; a joined frame's `camera` counts them."""
        return tuple(camera for camera in self.cameras if camera.takes_part)

    @property
    def cautions(self) -> tuple[str, ...]:
        """A sentence for each camera that was left out, or of which something is to be known."""
        return tuple(
            f"{camera.name} was left out: {camera.reason}"
            if camera.reason
            else f"{camera.name} {camera.note}"
            for camera in self.cameras
            if camera.reason or camera.note
        )


def joint_centre(offsets_m: Sequence[FloatArray]) -> FloatArray:
    """The mean over cameras of what their joints (5, 3) lie off the first one's, m."""
    return np.asarray(np.mean([np.zeros((len(JOINTS), 3)), *offsets_m], axis=0))
