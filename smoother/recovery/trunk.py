"""The thorax's orientation by an IMU on the trunk, at the samples of a recovery.

Beside the graph, not in it: the arm is the same with and without. The IMU's inertial filter gives the
orientation up to a heading that drifts slowly; the line of both shoulders, where the camera sees them, gives
the heading (`selfcal.trunk_mount`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import unit
from ..measurements.inertial import InertialSignal, inertial_attitude
from ..measurements.segment import without_spikes
from ..measurements.timestamps import dejitter, split_at_pauses
from ..recording import ImuStream, JointTracks, Recording, TrunkSensors
from ..result import Recovery, TrunkMotion
from ..rotation import Rotation
from ..runtime.store import large_array
from ..selfcal.trunk_mount import OFFSETS_S, ShoulderLine, TrunkMount, mount_trunk
from .blended_columns import between_quaternions
from .trunk_by_shoulders import JOINT_BIAS_M, shoulder_lines, trunk_by_shoulders

#: Worked on at a time, with this much around it, and blended over this much behind its beginning, s.
SECTION_S, CONTEXT_S, BLEND_S = 60.0, 15.0, 1.0
#: The ends of a run of samples are held this much longer, s: clocks known to some milliseconds end apart.
PADDING_S = 0.05
#: Sections that the mounting is found on, evenly spread, and frames with both shoulders that one needs.
EXCERPTS, FEWEST_FRAMES = 5, 60
#: The inertial filter runs no faster than this, Hz; a shorter run of samples is not worth one.
FEWEST_SAMPLES = 40
#: The vertical by the inertial filter and by the recovered direction of gravity, rad.
VERTICAL_RAD = np.radians(1.0)
#: A line of shoulders that departs by more than this, rms, does not move as the IMU does, rad.
WRONG_LIMB_RAD = np.radians(15.0)


def with_trunk(recovery: Recovery, recording: Recording) -> Recovery:
    """The recovery with the thorax's orientation, or with a note on why there is none."""
    trunk = recording.trunk
    if trunk is None:
        by_shoulders = trunk_by_shoulders(recovery, recording)
        return recovery if by_shoulders is None else replace(recovery, trunk=by_shoulders)
    motion, note = _motion(trunk, recovery, recording)
    return replace(recovery, trunk=motion, notes=(*recovery.notes, note))


def _motion(trunk: TrunkSensors, recovery: Recovery, recording: Recording) -> tuple[TrunkMotion | None, str]:
    name = trunk.imu.name
    if not np.isfinite(recovery.gravity_direction).all() or not len(recovery):
        return None, f"{name} was left out: the direction of gravity is not known"
    if trunk.other_arm is None or recording.side not in ("left", "right"):
        return None, f"{name} was left out: its heading needs both shoulders, and the skeleton shows one arm"
    up_K = -unit(recovery.gravity_direction)
    data = _TrunkData(trunk.imu, trunk.other_arm, recovery, recording)
    starts = np.arange(float(recovery.t_s[0]), float(recovery.t_s[-1]), SECTION_S)
    enough = [start for start in starts if data.frames(start, start + SECTION_S) >= FEWEST_FRAMES]
    chosen = {enough[int(k)] for k in np.linspace(0, len(enough) - 1, EXCERPTS)} if enough else set()
    lines = [line for start in sorted(chosen) for line in data.lines(start, 0.0)]
    if not lines:
        return None, f"{name} was left out: the camera hardly saw both shoulders with its samples"
    mount = mount_trunk(lines, up_K, recovery.estimates.joint_bias_sigma_m or JOINT_BIAS_M)
    if mount.line_sigma_rad > WRONG_LIMB_RAD:
        return None, (
            f"{name} was left out: the line of shoulders departs from its motion by"
            f" {np.degrees(mount.line_sigma_rad):.0f} degrees; check that it was on the trunk"
        )
    quaternion, covariance = large_array((len(recovery), 4)), large_array((len(recovery), 3, 3))
    for start in starts:
        for line in data.lines(start, mount.offset_s):
            _fill(quaternion, covariance, recovery.t_s, start, line, mount, up_K)
    offset_s = recovery.clock_offset_s + mount.offset_s
    motion = TrunkMotion(quaternion, covariance, mount.R_T_D, mount.sigma_rad, offset_s, name)
    return motion, f"{name} is used on the trunk; its usual posture is assumed upright"


class _TrunkData:
    """Evidence of IMU and camera on the trunk, a section at a time."""

    def __init__(self, imu: ImuStream, other: JointTracks, recovery: Recovery, recording: Recording) -> None:
        self._imu, self._other, self._recovery, self._recording = imu, other, recovery, recording

    def frames(self, start_s: float, end_s: float) -> int:
        """Frames with both shoulders between two times of the forearm IMU's clock."""
        return len(self._both(start_s, end_s)[0])

    def lines(self, start_s: float, offset_s: float) -> list[ShoulderLine]:
        """Of a section and what is around it, one a run of the trunk IMU's samples."""
        first_s, last_s = start_s - CONTEXT_S, start_s + SECTION_S + CONTEXT_S
        reach_s = 2.0 * float(OFFSETS_S[-1])
        rows = slice(*np.searchsorted(self._imu.t_s, [first_s - reach_s, last_s + reach_s]).tolist())
        own = self._imu.select(rows)
        own = ImuStream(own.name, np.array(own.t_s), np.array(own.acc), np.array(own.gyro))
        t, in_K, width = self._both(first_s, last_s)
        lines = []
        for run in split_at_pauses(own):
            if run.stop - run.start < FEWEST_SAMPLES:
                continue
            samples = without_spikes(own.select(run))
            signal = InertialSignal(replace(samples, t_s=dejitter(samples.t_s)))
            attitude = inertial_attitude(signal, samples.rate_hz)
            inside = (t + offset_s >= signal.start_s) & (t + offset_s <= signal.end_s)
            if inside.sum() >= FEWEST_FRAMES // 2:
                width_m = float(np.median(width[inside]))
                lines.append(
                    ShoulderLine(t[inside], in_K[inside], width_m, attitude, signal.start_s, signal.end_s)
                )
        return lines

    def _both(self, start_s: float, end_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See `shoulder_lines`."""
        return shoulder_lines(self._recovery, self._recording, self._other, start_s, end_s)


def _fill(
    quaternion: FloatArray,
    covariance: FloatArray,
    t_s: FloatArray,
    start_s: float,
    line: ShoulderLine,
    mount: TrunkMount,
    up_K: FloatArray,
) -> None:
    """The thorax at the samples of a section, blended with the section before over its beginning."""
    begin, end = line.start_s - mount.offset_s - PADDING_S, line.end_s - mount.offset_s + PADDING_S
    begin, end = max(start_s, begin), min(end, start_s + SECTION_S + BLEND_S)
    rows = slice(*np.searchsorted(t_s, [begin, end]).tolist())
    t = np.array(t_s[rows])
    if not len(t):
        return
    heading = line.heading(mount.along_D, up_K, mount.offset_s, mount.line_sigma_rad)
    at = t + mount.offset_s
    turned = heading.at(at) * line.attitude.at(at) * Rotation.from_matrix(mount.R_T_D.T)
    share = np.clip((t - start_s) / BLEND_S, 0.0, 1.0)
    before = np.array(quaternion[rows])
    quaternion[rows] = between_quaternions(before, turned.as_quat(scalar_first=True), share)
    about_up = np.interp(at, heading.t, heading.variance)[:, None, None] * np.outer(up_K, up_K)
    covariance[rows] = VERTICAL_RAD**2 * np.eye(3) + about_up
