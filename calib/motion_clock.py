"""A recording's camera clock against its IMU's, from the motion alone: no equipment.

The recording is cut into excerpts. On each the smoother's own self-calibration finds the clock offset (the
residuals of the camera's joints along their velocity); how the IMU sits on the arm is found once, from the
most informative excerpts, and kept for all. A robust line through the offsets gives offset and skew, and how
far the excerpts scatter about it gives sigma, whatever each of them claims.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.linalg import robust_sigma
from smoother.measurements.clock import LARGEST_OFFSET_S
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import Segment, split_into_segments
from smoother.recording import Recording
from smoother.runtime.pool import Pool
from smoother.selfcal.pairing import coarse_offset
from smoother.selfcal.rounds import self_calibrate

from .clock import SKEW_SIGMA, ClockLink

#: Beyond this the offset is looked for coarsely first, s: the self-calibration's reach, with room.
COARSE_S = 0.75 * LARGEST_OFFSET_S
#: Length of an excerpt, s, and at most this many of them.
EXCERPT_S = 20.0
MOST = 24
#: An excerpt needs this many frames with a visible forearm.
FEWEST_FRAMES = 60
#: What no excerpt is better than, s: frames are stamped that well at most.
FLOOR_S = 0.0005
#: With a longer recording the skew is looked for, s.
SKEW_SPAN_S = 60.0
PRIOR_SAMPLES = 4.0


@dataclass(frozen=True)
class MotionClock:
    """The clock of a recording from motion."""

    link: ClockLink  # Camera to IMU; t_imu = t_camera + offset
    t_s: FloatArray  # (k,) s: of each excerpt: its middle on the camera's clock, what it found
    offset_s: FloatArray  # (k,) s: of each excerpt: its middle on the camera's clock, what it found
    sigma_s: FloatArray  # (k,) s: of each excerpt: its middle on the camera's clock, what it found
    used: BoolArray  # bool (k,): excerpts that agree
    calibration: ArmCalibration  # How the IMU sits, as found on the way


def clock_from_motion(
    recording: Recording,
    known: ArmCalibration | None = None,
    config: Config | None = None,
    names: tuple[str, str] = ("camera", "imu"),
) -> MotionClock:
    """Offset and skew of the IMU's clock against the camera's from what both saw of the motion."""
    config = config or Config()
    known = known or ArmCalibration(side=recording.side)
    coarse = coarse_offset(recording, COARSE_S)
    if coarse:
        recording = replace(recording, imu=replace(recording.imu, t_s=recording.imu.t_s - coarse))
    segments = [reject_by_camera(segment) for segment in split_into_segments(recording, LARGEST_OFFSET_S)]
    excerpts = _excerpts(segments)
    if not excerpts:
        raise CalibrationError(
            f"{recording.name}: the forearm was visible for too short a time to find the clock; record"
            " 20 s of motion in view"
        )
    with Pool(config.windows.processes, sum(len(segment.frame_t_camera) for segment in segments)) as pool:
        arm = _mounting(excerpts, known, config, pool)
        clocks = [_one(excerpt, arm, config, pool) for excerpt in excerpts]
    rows = [(t, clock) for t, clock in clocks if clock is not None]
    if not rows:
        raise CalibrationError(
            f"{recording.name}: the clock could not be found in any excerpt; move more and faster"
        )
    t = np.array([t for t, _ in rows])
    offset = coarse + np.array([each[0] for _, each in rows])
    sigma = np.array([each[1] for _, each in rows])
    link, used = _line(t, offset, sigma, names, f"motion {recording.name}")
    return MotionClock(link, t, offset, sigma, used, arm)


def _excerpts(segments: list[Segment]) -> list[Segment]:
    """Parts of equal length with a visible forearm, spread over the recording."""
    parts = []
    for segment in segments:
        count = max(round((segment.end_s - segment.start_s) / EXCERPT_S), 1)
        edges = np.linspace(segment.start_s, segment.end_s, count + 1)
        parts += [segment.between(a, b) for a, b in pairwise(edges)]
    enough = [part for part in parts if _visible(part) >= FEWEST_FRAMES]
    if len(enough) <= MOST:
        return enough
    groups = np.array_split(np.arange(len(enough)), MOST)
    return [max((enough[k] for k in group.tolist()), key=_visible) for group in groups]


def _visible(segment: Segment) -> int:
    inside = (segment.frame_t_camera >= segment.start_s) & (segment.frame_t_camera <= segment.end_s)
    return int((segment.accepted[inside][:, 1:].sum(axis=1) >= segment.needed).sum())


def _mounting(excerpts: list[Segment], known: ArmCalibration, config: Config, pool: Pool) -> ArmCalibration:
    """How the IMU sits, from a few excerpts that may each have a clock of their own."""
    chosen = [excerpts[k] for k in np.unique(np.linspace(0, len(excerpts) - 1, 4).astype(int))]
    numbered = [replace(segment, recording=k) for k, segment in enumerate(chosen)]
    return self_calibrate(numbered, known, config, pool).estimate


def _one(
    excerpt: Segment, arm: ArmCalibration, config: Config, pool: Pool
) -> tuple[float, tuple[float, float] | None]:
    """Middle of an excerpt on the camera's clock, and the offset with its sigma; None where it fails."""
    middle = 0.5 * (excerpt.start_s + excerpt.end_s)
    try:
        solved = self_calibrate([excerpt], arm, config, pool)
    except CalibrationError:
        return middle, None
    clock = solved.clocks[0]
    at = float(clock.at(np.array([middle - clock.mean_s]))[0])
    return middle - at, (at, float(np.hypot(clock.sigma_s, FLOOR_S)))


def _line(
    t: FloatArray, offset: FloatArray, sigma: FloatArray, names: tuple[str, str], source: str
) -> tuple[ClockLink, BoolArray]:
    """A robust line through the excerpts' offsets, and which of them it is fitted to."""
    weight = sigma**-2
    has_skew = len(t) >= 3 and np.ptp(t) >= SKEW_SPAN_S
    prior = np.diag([0.0, SKEW_SIGMA**-2])
    for _ in range(30):
        centre = float(np.average(t, weights=weight))
        basis = np.stack([np.ones_like(t), (t - centre) * has_skew], axis=1)
        normal = basis.T @ (weight[:, None] * basis)
        level, skew = np.linalg.solve(normal + prior, basis.T @ (weight * offset))
        left = offset - basis @ [level, skew]
        middling = float(robust_sigma(left)) if len(t) >= 4 else 0.0
        spread = np.hypot(sigma, np.sqrt(max(middling**2 - float(np.median(sigma)) ** 2, 0.0)))
        weight = spread**-2 / (1 + (left / (2 * spread)) ** 2)
    used = np.abs(left) < 5 * spread
    weight = np.where(used, spread**-2, 0.0)
    freedom = max(int(used.sum()) - 1 - has_skew, 0)
    scatter = (PRIOR_SAMPLES + float(np.sum(weight * left**2))) / (PRIOR_SAMPLES + freedom)
    inverse = np.linalg.inv(basis.T @ (weight[:, None] * basis) / max(scatter, 1.0) + prior)
    sigma_s, skew_sigma = np.sqrt(np.diag(inverse)).tolist()
    found = (float(level), sigma_s, 1e6 * float(skew), 1e6 * skew_sigma, centre)
    return ClockLink(*names, *found, source=source), used
