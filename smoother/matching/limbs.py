"""Where an IMU may be worn: the two segments of every arm that the camera saw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..recording import JOINTS, JointState, JointTracks

#: A segment's joints: from, to; and how far along it the IMU's acceleration is taken.
SEGMENTS = {"wrist": ("elbow", "wrist", 1.0), "upper_arm": ("shoulder", "elbow", 0.7)}
#: Where the camera saw no wrist, the point that stands for the forearm's IMU.
_INSTEAD = ("strap", "hand", "elbow")


@dataclass(frozen=True)
class Limb:
    """One place for an IMU: the forearm (called by its wrist) or the upper arm, of one arm of one body.

    Attributes
    ----------
    tracks : JointTracks
        The arm.
    segment : str
        "wrist" or "upper_arm".
    body : int
        The camera's number of the body.
    side : str
        "left", "right" or "".
    skeleton : str
        Topic that the arm came from.
    """

    tracks: JointTracks
    segment: str
    body: int = 0
    side: str = ""
    skeleton: str = ""

    @property
    def joint(self) -> str:
        """Its name in a match, as "wrist_right"."""
        return f"{self.segment}_{self.side}" if self.side else self.segment

    @property
    def label(self) -> str:
        """For messages: joint and body."""
        return f"{self.joint} of body {self.body}"

    def between(self, start_s: float, end_s: float) -> Limb:
        """The same limb in the frames of some time, s on the camera's clock."""
        rows = slice(*np.searchsorted(self.tracks.t_s, [start_s, end_s]).tolist())
        return replace(self, tracks=self.tracks.select(rows))

    def seen_from_to(self) -> tuple[float, float]:
        """First and last time at which any of its joints is tracked, s."""
        first, second, _ = SEGMENTS[self.segment]
        joints = [JOINTS.index(joint) for joint in (first, second, *_INSTEAD)]
        rows = np.flatnonzero((self.tracks.state[:, joints] == JointState.TRACKED).any(axis=1))
        return float(self.tracks.t_s[rows[0]]), float(self.tracks.t_s[rows[-1]])

    def ends(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """The segment's two joints (F, 3), m in {K}, and the frames (F,) in which both are tracked."""
        first, second, _ = SEGMENTS[self.segment]
        arm = self.tracks
        return arm.joint(first), arm.joint(second), arm.tracked(first) & arm.tracked(second)

    def point(self) -> tuple[FloatArray, BoolArray]:
        """The point (F, 3), m in {K}, nearest to where an IMU sits, and the frames (F,) that show it."""
        first, second, both = self.ends()
        along = SEGMENTS[self.segment][2]
        if both.any():
            return first + along * (second - first), both
        for joint in ("wrist", *_INSTEAD) if self.segment == "wrist" else ():
            tracked = self.tracks.tracked(joint)
            if tracked.any():
                return self.tracks.joint(joint), tracked
        return first, both


def limbs_of(tracks: JointTracks, body: int = 0, side: str = "", skeleton: str = "") -> tuple[Limb, ...]:
    """The places on one arm that the camera saw at all.

    Parameters
    ----------
    tracks : JointTracks
        The arm.
    body : int
    side, skeleton : str
        As in `Limb`.

    Returns
    -------
    limbs : tuple of Limb
        None to two.
    """
    limbs = [Limb(tracks, segment, body, side, skeleton) for segment in SEGMENTS]
    return tuple(limb for limb in limbs if limb.point()[1].any())
