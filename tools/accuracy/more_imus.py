"""More IMUs than the one on the wrist, on the same simulated arms with them and without.

On the upper arm: `short` and `arm --imus 2`. On the trunk, for shoulder angles relative to it: `trunk`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.cli.config import read_config
from smoother.evaluation.validate import sample_errors
from smoother.joint_angles import wrapped_deg
from smoother.measurements.visibility import Gap
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.result.segment_motion import SegmentMotion, TrunkMotion
from smoother.shoulder_angles import SHOULDER_ANGLES, TRUNK_ANGLES, shoulder_angles, trunk_angles
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import (
    CALIBRATED,
    CHANGES,
    CONFIG,
    PRESETS,
    Check,
    changes,
    known_rms,
    option,
    preset_option,
    rms,
    seeds_option,
)

#: What is seen between two gaps, about, and before one at the end, s.
BETWEEN_GAPS_S, BEFORE_END_S = 8.0, 45.0
#: Gaps that one IMU still covers well, s; a recording has some of each, and this length, s.
SHORT_GAPS_S = (0.5, 1.0, 2.0, 3.0, 5.0)
SHORT_RECORDING_S = 60.0
#: How much larger the error with two IMUs may be.
NEVER_WORSE = 1.02


@dataclass(frozen=True)
class ChainErrors:
    """A gap's samples (n,) against the truth; `heading_deg` of forearm on upper arm, nan with one IMU."""

    distance_m: np.ndarray
    squared_sigmas: np.ndarray
    wrist_to_shoulder_m: np.ndarray
    angle_deg: np.ndarray
    heading_deg: np.ndarray


def compare_imus(options: argparse.Namespace) -> Iterator[str]:
    """A table of gaps by their length, with one IMU and with two; nothing is calibrated unless asked for."""
    config = read_config(options.config)
    given = "calibrated" if options.calibrated else "nothing calibrated"
    yield f"{given} preset {options.preset} {changes(options)}"
    for length_s in options.gap_s:
        gaps: dict[int, list[ChainErrors]] = {1: [], 2: []}
        spent = {1: 0.0, 2: 0.0}
        for seed in options.seeds:
            settings = _settings(length_s, options.at_end) | changes(options)
            simulated = simulate_arm(ArmSimulation.preset(options.preset, **settings), seed=seed)
            whole = replace(simulated.recording, truth=None)
            for imus, recording in ((1, whole.with_imu("upper_arm", None)), (2, whole)):
                recovery, seconds = _timed(recording, simulated, options, config)
                spent[imus] += seconds
                gaps[imus] += _gaps(recovery, simulated, length_s, options.at_end)
        for imus in (1, 2):
            yield from _show(length_s, imus, gaps[imus], spent[imus])
        one, two = (known_rms(np.concatenate([gap.distance_m for gap in gaps[imus]])) for imus in (1, 2))
        yield (f"    two against one: error {two / one:.2f}, time {spent[2] / spent[1]:.2f}")


def compare_short_gaps(options: argparse.Namespace) -> Iterator[str]:
    """Gaps of 0.5 to 5 s with one IMU and with two: nowhere is the error to be larger than 1.02 times."""
    config = read_config(options.config)
    settings = {
        "imus": "wrist,upper-arm",
        "protocol": "random",
        "duration_s": SHORT_RECORDING_S,
        "occlusion_lengths_s": SHORT_GAPS_S,
    } | changes(options)
    for preset in options.presets:
        gaps: dict[tuple[float, int], list[ChainErrors]] = {}
        spent = {1: 0.0, 2: 0.0}
        for seed in options.seeds:
            simulated = simulate_arm(ArmSimulation.preset(preset, **settings), seed=seed)
            whole = replace(simulated.recording, truth=None)
            for imus, recording in ((1, whole.with_imu("upper_arm", None)), (2, whole)):
                recovery, seconds = _timed(recording, simulated, options, config)
                spent[imus] += seconds
                for gap, errors in _scored_gaps(recovery, simulated, recovery.gaps):
                    length_s = min(SHORT_GAPS_S, key=lambda s: abs(s - gap.length_s))
                    gaps.setdefault((length_s, imus), []).append(errors)
                    gaps.setdefault((np.inf, imus), []).append(errors)
        yield (f"preset {preset} {changes(options)}, seeds {options.seeds.start} to {options.seeds.stop - 1}")
        yield ("  gap      gaps   one, cm   two, cm   ratio   squared error / sigma^2, one and two")
        for length_s in (*SHORT_GAPS_S, np.inf):
            one, two = (gaps.get((length_s, imus), []) for imus in (1, 2))
            if one and two:
                yield (_short_line(length_s, one, two))
        yield (f"  time, two against one: {spent[2] / spent[1]:.2f}")


def _short_line(length_s: float, one: list[ChainErrors], two: list[ChainErrors]) -> str:
    first, second = (known_rms(np.concatenate([gap.distance_m for gap in gaps])) for gaps in (one, two))
    squares = [np.nanmean(np.concatenate([gap.squared_sigmas for gap in gaps])) / 3 for gaps in (one, two)]
    name = "all" if np.isinf(length_s) else f"{length_s:g} s"
    verdict = "" if second <= NEVER_WORSE * first else "  two are worse"
    return (
        f"  {name:6} {len(one):6}   {100 * first:7.3f}   {100 * second:7.3f}   {second / first:5.3f}"
        f"   {squares[0]:.2f} {squares[1]:.2f}{verdict}"
    )


def _settings(length_s: float, at_end: bool) -> dict[str, Any]:
    if at_end:
        return {
            "imus": "wrist,upper-arm",
            "protocol": "random",
            "duration_s": BEFORE_END_S + length_s,
            "occlusion_lengths_s": (),
            "end_gap_s": length_s,
        }
    return {
        "imus": "wrist,upper-arm",
        "protocol": "random",
        "duration_s": max(60.0, 2.5 * length_s),
        "occlusion_lengths_s": (length_s,),
        "occlusion_every_s": length_s + BETWEEN_GAPS_S,
    }


def _timed(
    recording: Recording, simulated: SimulatedArm, options: argparse.Namespace, config: Any
) -> tuple[Recovery, float]:
    began = time.process_time()
    calibration = simulated.calibration if options.calibrated else None
    recovery = smooth(recording, calibration, config, processes=1)
    return recovery, time.process_time() - began


def _gaps(recovery: Recovery, simulated: SimulatedArm, length_s: float, at_end: bool) -> list[ChainErrors]:
    """Of each gap of about that length; of the recording's end as much, answered or not."""
    end_s = float(recovery.t_s[-1])
    if at_end:
        wanted: tuple[Gap, ...] = (Gap(end_s - length_s, end_s + 1.0, open_end=True),)
    else:  # the preset makes gaps of some frames besides
        wanted = tuple(gap for gap in recovery.gaps if gap.length_s >= 0.5 * length_s)
    return [errors for _, errors in _scored_gaps(recovery, simulated, wanted)]


def _scored_gaps(
    recovery: Recovery, simulated: SimulatedArm, gaps: tuple[Gap, ...]
) -> Iterator[tuple[Gap, ChainErrors]]:
    """Gaps and their errors; of one that is open at the end all samples, answered or not."""
    truth = simulated.recording.truth
    assert truth is not None
    errors = sample_errors(recovery, truth)
    for gap in gaps:
        inside = (recovery.t_s > gap.start_s) & (recovery.t_s < gap.end_s)
        rows = np.flatnonzero(inside if gap.open_end else inside & errors.scored)
        if not len(rows):
            continue
        answer, true = (
            joints["wrist"][rows] - joints["shoulder"][rows] for joints in (recovery.joints, truth.joints)
        )
        yield (
            gap,
            ChainErrors(
                errors.distance_m[rows],
                errors.squared_sigmas[rows],
                np.linalg.norm(answer - true, axis=1),
                errors.angle_deg[rows],
                _heading(recovery.rows(rows), simulated),
            ),
        )


def _heading(recovery: Recovery, simulated: SimulatedArm) -> np.ndarray:
    """Error of the forearm's heading against the upper arm's (n,), degrees."""
    assert simulated.upper_motion is not None
    heading = np.full(len(recovery), np.nan)
    if recovery.upper is None:
        return heading
    known = np.isfinite(recovery.upper.quaternion).all(axis=1) & np.isfinite(recovery.quaternion).all(axis=1)
    t = recovery.t_s[known]
    turns = []
    for quaternion, motion in (
        (recovery.quaternion, simulated.motion),
        (recovery.upper.quaternion, simulated.upper_motion),
    ):
        answer = Rotation.from_quat(quaternion[known], scalar_first=True)
        turns.append(answer * Rotation.from_matrix(motion.imu_pose(t)[0]).inv())
    between = (turns[0] * turns[1].inv()).as_rotvec()
    heading[known] = np.degrees(between @ recovery.gravity_direction)
    return heading


def _show(length_s: float, imus: int, gaps: list[ChainErrors], seconds: float) -> Iterator[str]:
    def every(name: str) -> np.ndarray:
        return np.concatenate([getattr(gap, name) for gap in gaps])

    if not gaps:
        yield (f"{length_s:g} s: no gap")
        return
    distance = every("distance_m")
    last = np.array([gap.heading_deg[-40:] for gap in gaps if len(gap.heading_deg) >= 40])
    yield (
        f"{length_s:4g} s, {imus} IMU, {len(gaps):3} gaps: rms {100 * known_rms(distance):5.2f} cm  max"
        f" {100 * np.nanmax(distance):5.2f}  squared error / sigma^2"
        f" {np.nanmean(every('squared_sigmas')) / 3:4.2f}  wrist to shoulder"
        f" {100 * known_rms(every('wrist_to_shoulder_m')):5.2f} cm"
        f"  orientation {known_rms(every('angle_deg')):4.2f}"
        f" deg  relative heading at the end {known_rms(last) if np.isfinite(last).any() else np.nan:4.2f} deg"
        f"  answered {100 * np.isfinite(distance).mean():.1f} %  {seconds:.1f} s"
    )


#: A humerus that is raised by less, or nearly upright, has no plane of elevation, degrees.
RAISED_DEG = (25.0, 155.0)


def compare_trunk(options: argparse.Namespace) -> Iterator[str]:
    """Shoulder angles relative to the thorax: by an IMU on it, and as if the trunk stood still."""
    settings = {
        "imus": "wrist,upper-arm,trunk",
        "protocol": "random",
        "duration_s": 60.0,
        "trunk_turn_deg": 10.0,
    } | changes(options)
    yield (f"preset {options.preset} {settings}")
    tilt, heading, squares = [], [], []
    angles: dict[str, list[np.ndarray]] = {}
    for seed in options.seeds:
        made = simulate_arm(ArmSimulation.preset(options.preset, **settings), seed=seed)
        recovery = smooth(replace(made.recording, truth=None), processes=1)
        if recovery.trunk is None or made.trunk_motion is None:
            yield (f"seed {seed}: {recovery.notes[-1]}")
            continue
        error, square = _thorax(recovery, made)
        tilt.append(error[:, [0, 2]])
        heading.append(error[:, 1])
        squares.append(square)
        yield (
            f"seed {seed:3}: lean {rms(error[:, [0, 2]]):.2f}, heading {rms(error[:, 1]):.2f} deg,"
            f" squared error / sigma^2 {np.mean(square):.2f}"
        )
        for name, errors in _angles(recovery, made).items():
            angles.setdefault(name, []).append(errors)
    if not tilt:
        return
    yield (
        f"all: lean {rms(np.vstack(tilt)):.2f}, heading {rms(np.concatenate(heading)):.2f} deg,"
        f" squared error / sigma^2 {np.mean(np.concatenate(squares)):.2f}"
    )
    for name, values in angles.items():
        with_imu, without, ratio = np.vstack(values).T
        yield (
            f"  {name:26} rms {rms(with_imu):5.2f} deg, without the trunk's IMU {rms(without):5.2f} deg,"
            f" squared error / sigma^2 {np.mean(ratio**2):.2f}"
        )


def _thorax(recovery: Recovery, made: SimulatedArm) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 3) about the thorax's axes, degrees, and squared errors over sigma^2 (n,)."""
    trunk = recovery.trunk
    assert trunk is not None and made.trunk_motion is not None
    known = np.isfinite(trunk.quaternion[:, 0])
    R = Rotation.from_quat(trunk.quaternion[known], scalar_first=True).as_matrix()
    true = made.trunk_motion.thorax(recovery.t_s[known])
    error = Rotation.from_matrix(np.swapaxes(true, 1, 2) @ R).as_rotvec()
    covariance = np.swapaxes(R, 1, 2) @ trunk.covariance[known] @ R + np.diag(trunk.mount_sigma_rad**2)
    return np.degrees(error), np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0


def _angles(recovery: Recovery, made: SimulatedArm) -> dict[str, np.ndarray]:
    """By angle: error with the trunk's IMU, without it, degrees, and the first over sigma, (n, 3)."""
    assert made.trunk_motion is not None and made.upper_motion is not None and recovery.trunk is not None
    answer, sigma = trunk_angles(recovery)
    upright, _ = shoulder_angles(recovery)
    # the truth by the same functions, on the bone itself
    t, n = recovery.t_s, len(recovery)
    nothing = np.zeros((n, 6, 6))
    thorax = Rotation.from_matrix(made.trunk_motion.thorax(t)).as_quat(scalar_first=True)
    _, R_K_U = made.motion.upper_arm(t)  # type: ignore[attr-defined]
    bone = R_K_U @ made.upper_motion.mount.axes
    quaternion = Rotation.from_matrix(bone).as_quat(scalar_first=True)
    true = replace(
        recovery,
        calibration=made.calibration,
        trunk=TrunkMotion(thorax, nothing[:, :3, :3], np.eye(3), np.zeros(3)),
        segments={"upper_arm": SegmentMotion(np.zeros((n, 3)), quaternion, nothing, np.zeros(3))},
    )
    truth, _ = trunk_angles(true)
    elevation = truth["shoulder_elevation_trunk"]
    rows = (elevation > RAISED_DEG[0]) & (elevation < RAISED_DEG[1])
    rows &= np.isfinite(answer["shoulder_elevation_trunk"])
    out = {}
    for name, plain in zip(TRUNK_ANGLES, SHOULDER_ANGLES, strict=True):
        off = wrapped_deg(answer[name] - truth[name])[rows]
        out[name] = np.stack(
            [off, wrapped_deg(upright[plain] - truth[name])[rows], off / sigma[name][rows]], axis=1
        )
    return out


CHECKS = (
    Check(
        "short",
        compare_short_gaps,
        (
            option("--presets", nargs="+", default=["white", "realistic"], choices=PRESETS),
            CALIBRATED,
            CHANGES,
            CONFIG,
            seeds_option("3"),
        ),
    ),
    Check("trunk", compare_trunk, (preset_option("realistic"), CHANGES, seeds_option("3"))),
)
