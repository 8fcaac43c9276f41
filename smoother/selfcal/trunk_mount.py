"""How an IMU sits on the trunk, its clock, and the evidence of the camera's two shoulders on its heading.

The thorax {T} has the ISB's axes: x forward, y up, z to its right. Up is where gravity has it in the trunk's
usual posture (the median over the recording), as a skeleton's shoulders do not show how far a trunk leans; z
lies along the line of both shoulders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import nearest_rotation, parabola_vertex, unit
from ..measurements.inertial import InertialAttitude
from ..rotation import Rotation

#: Errors of the shoulders last about this long, s: nearer frames give together no more information than one.
#: The mounting is found on frames this far apart, s.
MEMORY_S, FRAME_S = 0.7, 0.15
#: The heading is a line in time over about this long on both sides, s: a gyroscope's bias turns it steadily.
#: It is computed at this interval, s.
LOCAL_S, STEP_S = 12.0, 1.0
#: How fast the heading may leave that line, rad/s, where there is no frame with both shoulders.
DRIFT_RAD_S = np.radians(0.05)
#: Headings that are tried at the start, rad, and steps from there.
HEADINGS = np.radians(np.arange(0.0, 360.0, 15.0))
STEPS = 6
#: Offsets of the trunk IMU's clock against the forearm's that are tried, s, and how far from zero it is, s.
OFFSETS_S = np.arange(-0.6, 0.601, 0.05)
OFFSET_SIGMA_S = 0.3
#: A shoulder moves this far against the trunk as the arm reaches forwards, m.
GIRDLE_M = 0.012
#: What the skin lets an IMU turn, and how far "usual" is from upright, rad about each axis.
POSTURE_RAD = np.radians(1.5)
#: Median length of a two-dimensional error of unit sigma; a frame counts no more than this many sigmas.
RAYLEIGH_MEDIAN, OUTLIER = 1.177, 3.0
SMALLEST_RAD = np.radians(0.2)


@dataclass(frozen=True)
class TrunkHeading:
    """`R_K_E` of a trunk's IMU over time: the vertical is known, the heading follows the shoulders."""

    level: Rotation  # Maps the vertical of {E} to that of {K}, at a heading of zero
    t: FloatArray  # (k,) s: on the trunk IMU's clock, increasing
    heading: FloatArray  # (k,) rad
    variance: FloatArray  # (k,) rad^2

    def at(self, t: FloatArray) -> Rotation:
        """`R_K_E` at the given times, held beyond the ends."""
        return self.level * Rotation.about_z(np.interp(t, self.t, self.heading))


@dataclass(frozen=True)
class ShoulderLine:
    """The line from the left shoulder to the right one where the camera sees both, and the trunk's
    attitude.
    """

    t: FloatArray  # (n,) s: frames on the forearm IMU's clock
    in_K: FloatArray  # (n, 3): unit vectors
    width_m: float  # Of the shoulders
    attitude: InertialAttitude  # The trunk's IMU in a frame {E} with z up; its times are on that IMU's clock
    start_s: float  # What the attitude covers, on that IMU's clock
    end_s: float  # What the attitude covers, on that IMU's clock

    @property
    def share(self) -> float:
        """What a frame says, against one whose error is its own."""
        step_s = float(np.median(np.diff(self.t))) if len(self.t) > 1 else MEMORY_S
        return min(step_s / MEMORY_S, 1.0)

    def decimated(self) -> ShoulderLine:
        """The same with frames `FRAME_S` apart: the mounting needs no more."""
        every = max(round(FRAME_S * (len(self.t) - 1) / max(float(self.t[-1] - self.t[0]), FRAME_S)), 1)
        return replace(self, t=self.t[::every], in_K=self.in_K[::every])

    def heading(
        self, along_D: FloatArray, up_K: FloatArray, offset_s: float, sigma_rad: float
    ) -> TrunkHeading:
        """The heading by local lines through what each frame says, twice, what is far off weighted down."""
        level = _level(up_K)
        t = self.t + offset_s
        by_camera, by_imu = level.inv().apply(self.in_K), self.attitude.at(t).apply(along_D)
        seen = np.unwrap(
            np.arctan2(by_camera[:, 1], by_camera[:, 0]) - np.arctan2(by_imu[:, 1], by_imu[:, 0])
        )
        grid = np.arange(self.start_s, self.end_s + STEP_S, STEP_S)
        weight = np.ones(len(t))
        for _ in range(2):
            heading, variance = _local_line(t, seen, weight, grid)
            off = (seen - np.interp(t, grid, heading)) / sigma_rad
            weight = 1.0 / (1.0 + (off / OUTLIER) ** 2)
        away = np.min(np.abs(grid[:, None] - t[None, :: max(len(t) // 500, 1)]), axis=1)
        variance = variance * sigma_rad**2 / self.share + (DRIFT_RAD_S * away) ** 2
        return TrunkHeading(level, grid, heading, variance)

    def seen_from_imu(self, heading: TrunkHeading, offset_s: float) -> FloatArray:
        """The line in the IMU's axes {D}, (n, 3)."""
        t = self.t + offset_s
        return np.asarray((heading.at(t) * self.attitude.at(t)).inv().apply(self.in_K))


def _level(up_K: FloatArray) -> Rotation:
    return Rotation.from_matrix(nearest_rotation(np.outer(up_K, [0.0, 0.0, 1.0]) + 1e-6 * np.eye(3)))


def _local_line(
    t: FloatArray, y: FloatArray, weight: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Lines through samples (n,) by their distance in time, at (k,) times; variance for unit noise."""
    u = t - at[:, None]
    w = weight * (np.exp(-np.abs(u) / LOCAL_S) + 1e-9)
    s0, s1, s2 = w.sum(axis=1), (w * u).sum(axis=1), (w * u**2).sum(axis=1) + 1e-6 * w.sum(axis=1)
    gain = w * (s2[:, None] - s1[:, None] * u) / (s0 * s2 - s1**2)[:, None]
    return gain @ y, (gain**2).sum(axis=1)


@dataclass(frozen=True)
class TrunkMount:
    """How an IMU sits on the trunk."""

    R_T_D: FloatArray  # (3, 3): maps a vector from the IMU's axes {D} to the thorax's
    along_D: FloatArray  # (3,): the line from the left shoulder to the right one, unit vector
    offset_s: float  # t_trunk = t_forearm + offset
    line_sigma_rad: float  # Of the camera's line of shoulders in a frame, per axis perpendicular to it
    sigma_rad: FloatArray  # (3,) rad: how far the mounting may be off about each of the thorax's axes


def mount_trunk(
    lines: Sequence[ShoulderLine],
    up_K: FloatArray,  # (3,)
    joint_bias_m: float,
) -> TrunkMount:
    """Find how an IMU sits on the trunk, and its clock, on some excerpts."""
    lines = [line.decimated() for line in lines]
    longest = lines[int(np.argmax([len(line.t) for line in lines]))]
    along, offset_s, sigma = _first_direction(longest, up_K), 0.0, np.radians(5.0)
    for _ in range(2):
        along, sigma = _direction(lines, along, up_K, offset_s, sigma)
        offset_s = _offset(lines, along, up_K, sigma)
    along, sigma = _direction(lines, along, up_K, offset_s, sigma)
    up = _usual_up(lines)
    z = unit(along - (along @ up) * up)
    R_T_D = np.stack([np.cross(up, z), up, z])
    width_m = float(np.median([line.width_m for line in lines]))
    independent = max(sum(len(line.t) * line.share for line in lines), 1.0)
    line_m = np.hypot(np.sqrt(2.0) * joint_bias_m, GIRDLE_M)
    turned = float(np.hypot(line_m / width_m, sigma / np.sqrt(independent)))
    return TrunkMount(R_T_D, along, offset_s, sigma, np.array([POSTURE_RAD, turned, POSTURE_RAD]))


def _first_direction(line: ShoulderLine, up_K: FloatArray) -> FloatArray:
    """The direction in {D} at the constant heading for which it varies least."""
    in_E = _level(up_K).inv().apply(line.in_K)
    means = []
    for heading in HEADINGS:
        turned = Rotation.about_z(-heading).apply(in_E)
        means.append(line.attitude.at(line.t).inv().apply(turned).mean(axis=0))
    return unit(max(means, key=lambda mean: float(np.linalg.norm(mean))))


def _direction(
    lines: Sequence[ShoulderLine], along_D: FloatArray, up_K: FloatArray, offset_s: float, sigma_rad: float
) -> tuple[FloatArray, float]:
    """The direction of the shoulders in {D} from a start, and the sigma of one frame's."""
    for _ in range(STEPS):
        seen = np.vstack(
            [line.seen_from_imu(line.heading(along_D, up_K, offset_s, sigma_rad), offset_s) for line in lines]
        )
        along_D = unit(np.median(seen, axis=0))
    return along_D, max(float(np.median(_across(seen, along_D))) / RAYLEIGH_MEDIAN, SMALLEST_RAD)


def _across(seen_D: FloatArray, along_D: FloatArray) -> FloatArray:
    """How far directions (n, 3) depart from one, (n,) rad."""
    return np.asarray(np.linalg.norm(np.cross(seen_D, along_D), axis=1))


def _offset(lines: Sequence[ShoulderLine], along_D: FloatArray, up_K: FloatArray, sigma_rad: float) -> float:
    """The clock at which the line of shoulders departs least from where the IMU has it."""
    loss = []
    for offset_s in OFFSETS_S:
        total = 0.5 * (offset_s / OFFSET_SIGMA_S) ** 2
        for line in lines:
            heading = line.heading(along_D, up_K, offset_s, sigma_rad)
            across = _across(line.seen_from_imu(heading, offset_s), along_D) / sigma_rad
            total += 0.5 * line.share * float(np.minimum(across**2, OUTLIER**2).sum())
        loss.append(total)
    return parabola_vertex(OFFSETS_S, np.array(loss))


def _usual_up(lines: Sequence[ShoulderLine]) -> FloatArray:
    """Up in {D}: the median over time."""
    ups = [line.attitude.R_E_A.inv().apply([0.0, 0.0, 1.0]) for line in lines]
    return unit(np.median(np.vstack(ups), axis=0))
