"""What a recording allows, before anything is solved: how long gaps may be, and what nothing determines.

A rule of thumb with three parts. A floor: the camera's noise, and speed times how well frames are dated. A
growth with the length of the gap: 7 mm a second for a sensor whose ends alone are seen (BROAD: 0.5, 0.9, 1.3
and 2.1 cm at 0.5, 1, 2 and 3 s), half of it where a shoulder constrains the arm, more for a slow IMU or a
mounting that does not show. And what must move for the mounting to show. Slow errors of a body tracker show
in no single recording; `gaps` measures them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..recording import JOINTS, Recording
from .timestamps import synthetic_stamps
from .visibility import find_gaps, visible_frames

#: Growth of the error in a gap, m/s, alone and with a shoulder; of an IMU of at least this many Hz.
GROWTH_ALONE, GROWTH_WITH_SHOULDER, FULL_RATE_HZ = 0.007, 0.0035, 80.0
#: What a mounting that does not show makes of it.
UNKNOWN_MOUNTING = 2.0
#: Gaps that are longer are said to be of some seconds, s.
SOME_SECONDS_S = 1.5
#: How well frames are dated, s; where stamps are synthetic.
DATED_S, SYNTHETIC_S = 0.003, 0.06
#: Errors that are asked for in turn, m; gaps shorter than this, or longer, are not named, s.
ASKED_M = (0.02, 0.05, 0.10)
SHORTEST_S, LONGEST_S = 0.3, 30.0
#: An IMU or a camera slower than this, Hz, allows nothing; one slower than the second little.
TOO_SLOW_HZ, SLOW_HZ, CAMERA_SLOW_HZ = 15.0, 38.0, 8.0
#: Words of the sentence for a mounting that does not show.
NOTHING = "nothing determines"
#: Least time in view, s, and rms turn rate about the two liveliest axes, rad/s, that show the mounting.
IN_VIEW_S, FIRST_AXIS, SECOND_AXIS = 5.0, 0.2, 0.1
#: Rays of a camera without depth are points a metre away; arms are about so far, m.
USUAL_DISTANCE_M = 2.0
#: What one of them alone leaves open of the distance at ordinary speed, m.
ALONE_M = 0.03


@dataclass(frozen=True)
class Allowance:
    """What a recording allows."""

    longest_s: float | None  # Up to this length gaps are expected to be recovered within `within_m`
    within_m: float  # Rms error
    obstacles: tuple[str, ...] = ()  # Why no answer could be trusted
    undetermined: tuple[str, ...] = ()  # What nothing in the recording determines

    @property
    def ready(self) -> bool:
        """Nothing stands against recovering it."""
        return not self.obstacles

    @property
    def sentence(self) -> str:
        """In a line."""
        if self.obstacles:
            return f"does not allow a result to be trusted: {'; '.join(self.obstacles)}"
        within = f"{100 * self.within_m:.0f} cm"
        if self.longest_s is None:
            first = f"allows no gap within {within}"
        else:  # `check` tries the lengths: two numbers for one thing confuse
            some = "some seconds" if self.longest_s >= SOME_SECONDS_S else "a second or less"
            first = f"allows gaps of {some} within {within} (rule of thumb; `unocclude check` tests it)"
        return "; ".join([first, *self.undetermined])


def allowance(recording: Recording) -> Allowance:
    """What a recording allows, by its rates, joints, noise and movement."""
    arm, imu = recording.arm, recording.imu
    obstacles = tuple(_obstacles(recording))
    if obstacles:
        return Allowance(None, ASKED_M[-1], obstacles)
    joint = next(name for name in ("strap", "wrist", "hand", "elbow") if name in arm.present)
    position = arm.joint(joint)[arm.tracked(joint)]
    if arm.pixel_rad is not None:
        position = USUAL_DISTANCE_M * position
    noise_m, speed = _noise_and_speed(arm.t_s[arm.tracked(joint)], position)
    floor_m = float(np.hypot(noise_m, speed * (SYNTHETIC_S if synthetic_stamps(arm.t_s) else DATED_S)))
    if _is_alone(recording):
        floor_m = float(np.hypot(floor_m, ALONE_M))
    growth = GROWTH_WITH_SHOULDER if {"shoulder", "elbow"} <= set(arm.present) else GROWTH_ALONE
    growth *= max(FULL_RATE_HZ / imu.rate_hz, 1.0)
    undetermined = tuple(_undetermined(recording))
    if any(NOTHING in sentence for sentence in undetermined):
        growth *= UNKNOWN_MOUNTING
    common_s = min(arm.t_s[-1], imu.t_s[-1]) - max(arm.t_s[0], imu.t_s[0])
    if recording.clocks_unrelated:
        common_s = min(np.ptp(arm.t_s), np.ptp(imu.t_s))
    most_s = min(LONGEST_S, 0.5 * float(common_s))
    for within_m in ASKED_M:
        longest_s = float(np.sqrt(max(within_m**2 - floor_m**2, 0.0)) / growth)
        if longest_s >= SHORTEST_S:
            return Allowance(min(longest_s, most_s), within_m, (), undetermined)
    return Allowance(None, ASKED_M[-1], (), undetermined)


def _obstacles(recording: Recording) -> Iterator[str]:
    arm, imu = recording.arm, recording.imu
    if not imu.rate_hz >= TOO_SLOW_HZ:
        yield f"the IMU has {imu.rate_hz:.2g} samples per second, where 40 are needed and 80 are better"
    if not arm.rate_hz >= CAMERA_SLOW_HZ:
        yield f"the camera has {arm.rate_hz:.2g} frames per second, where 15 are needed"
    if not any(joint in arm.present for joint in JOINTS if joint != "shoulder"):
        yield "the forearm is never tracked"
    if arm.pixel_rad is not None and recording.cameras and all(c.pose is None for c in recording.cameras):
        yield (
            "keypoints of cameras whose places are unknown do not show how far away the arm is; a camera with"
            " depth, a place that is known or --skeleton with one of them alone does"
        )
    if _is_alone(recording) and not {"elbow", "wrist"} <= set(arm.present):
        yield ("one camera without depth needs elbow and wrist: nothing else shows how far away the arm is")
    start_s, end_s = max(arm.t_s[0], imu.t_s[0]), min(arm.t_s[-1], imu.t_s[-1])
    if end_s - start_s < 2.0 and not recording.clocks_unrelated:
        yield (
            f"IMU and camera have {max(end_s - start_s, 0.0):.1f} s in common by their stamps: their clocks"
            " are far apart, or the recording is too short"
        )


def _is_alone(recording: Recording) -> bool:
    """One camera without depth is all there is."""
    return recording.arm.pixel_rad is not None and not recording.cameras


def _undetermined(recording: Recording) -> Iterator[str]:
    arm, imu = recording.arm, recording.imu
    if _is_alone(recording):
        yield (
            "one camera without depth: how far away the arm is shows by fast movement in view, and to some"
            " 9 % by the arm's length (--body-height: 7 %)"
        )
    if imu.rate_hz < SLOW_HZ:
        yield f"the IMU is slow ({imu.rate_hz:.0f} Hz)"
    if arm.present == ("strap",):
        return
    visible = visible_frames(arm)
    seen_s = float(visible.sum() / arm.rate_hz)
    if seen_s < IN_VIEW_S:
        yield f"the forearm is in view for {seen_s:.0f} s only, so {NOTHING} how the sensor sits on it"
        return
    if not {"elbow", "wrist"} <= set(arm.present):
        yield f"without elbow and wrist {NOTHING} the forearm's direction and its roll"
        return
    start_s, end_s = float(imu.t_s[0]), float(imu.t_s[-1])
    gaps = find_gaps(arm.t_s, visible, start_s, end_s)
    inside = np.ones(len(imu), dtype=bool)
    for gap in gaps:
        inside[slice(*np.searchsorted(imu.t_s, [gap.start_s, gap.end_s]).tolist())] = False
    gyro = np.asarray(imu.gyro)[inside]
    rates = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(gyro.T)), 0.0)) if len(gyro) > 3 else np.zeros(3)
    if rates[2] < FIRST_AXIS:
        yield f"the arm hardly turns in view: {NOTHING} how the sensor sits on it"
    elif rates[1] < SECOND_AXIS:
        yield f"in view the arm turns about one axis only: {NOTHING} the roll"
    if "shoulder" not in arm.present:
        yield "without a shoulder long gaps are held at their ends only"


def _noise_and_speed(t_s: FloatArray, position: FloatArray) -> tuple[float, float]:
    """White noise of a joint, m per axis, and its rms speed, m/s; pairs of frames far apart are left out."""
    step = np.diff(t_s)
    near = step < 1.6 * np.median(step)
    velocity = np.diff(position, axis=0)[near] / step[near, None]
    fourth = np.diff(position, 4, axis=0)[
        near[:-3] & near[1:-2] & near[2:-1] & near[3:]
    ]  # of white noise: variance 70 sigma^2
    if len(fourth) < 10:
        return 0.01, 0.5
    noise_m = 1.4826 * float(np.median(np.abs(fourth))) / np.sqrt(70.0)
    # noise makes a speed of its own
    own = 2.0 * noise_m**2 / float(np.median(step)) ** 2 * 3.0
    squared = np.sum(velocity**2, axis=1)
    return noise_m, float(np.sqrt(max(np.mean(np.minimum(squared, np.percentile(squared, 98))) - own, 0.0)))
