"""One depth camera against several on the same simulated arms: `cameras`."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.evaluation.metrics import squared_sigmas
from smoother.result import CameraEstimate, Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import CHANGES, PRESET, changes, check, option, rms, seeds_option


def wrist_errors(recovery: Recovery, simulated: SimulatedArm, rows: np.ndarray) -> np.ndarray:
    """The wrist's errors at some samples with an answer (n, 2): distance, m, and squared sigmas / 3."""
    truth = simulated.recording.truth
    assert truth is not None
    error = (recovery.joints["wrist"] - truth.joints["wrist"])[rows]
    known = np.isfinite(error).all(axis=1)
    squared = squared_sigmas(error[known], recovery.joint_covariance["wrist"][rows][known])
    return np.column_stack([np.linalg.norm(error[known], axis=1), squared / 3.0])


def placing_error(found: CameraEstimate, simulated: SimulatedArm) -> tuple[float, float, float]:
    """Degrees, cm where the arm is, ms of the clock."""
    true = simulated.parameters["cameras"][found.name]
    R = np.array(found.R_K_C)
    turned = np.linalg.norm(Rotation.from_matrix(R @ true["R_K_C"].T).as_rotvec())
    truth = simulated.recording.truth
    assert truth is not None
    arm = np.median(truth.position, axis=0)
    there = R @ true["R_K_C"].T @ (arm - true["p_K_C_m"]) + np.array(found.p_K_C_m)
    late = (found.offset_s or 0.0) - true["offset_s"]
    return float(np.degrees(turned)), 100 * float(np.linalg.norm(there - arm)), 1000 * late


@check(
    PRESET,
    option("--angles", type=float, nargs="+", default=[75.0], help="of the further cameras, degrees"),
    seeds_option("5000:5008"),
    CHANGES,
)
def cameras(options: argparse.Namespace) -> Iterator[str]:
    """The wrist's error in the first camera's gaps, with it alone and with further ones; nothing
    calibrated.
    """
    settings = {
        "protocol": "random",
        "duration_s": 60.0,
        "cameras": tuple(options.angles),
        "camera_clock_s": 0.35,
    } | changes(options)
    kinds = ("gaps", "helped", "blind", "visible")
    found: dict[tuple[str, int], list[np.ndarray]] = {}
    placed: list[tuple[float, float, float]] = []
    spent = [0.0, 0.0]
    for seed in options.seeds:
        simulated = simulate_arm(ArmSimulation.preset(options.preset, **settings), seed=seed)
        whole = replace(simulated.recording, truth=None)
        answers = []
        for number, recording in enumerate((replace(whole, cameras=()), whole)):
            began = time.monotonic()
            answers.append(smooth(recording, processes=1))
            spent[number] += time.monotonic() - began
        one, several = answers
        masks = {
            "gaps": one.occluded,
            "helped": one.occluded & ~several.occluded,
            "blind": one.occluded & several.occluded,
            "visible": ~one.occluded,
        }
        for kind in kinds:
            for number, recovery in enumerate(answers):
                found.setdefault((kind, number), []).append(wrist_errors(recovery, simulated, masks[kind]))
        used = [camera for camera in several.estimates.cameras[1:] if camera.takes_part]
        placed += [placing_error(camera, simulated) for camera in used]
        if len(used) < len(options.angles):
            yield f"  seed {seed}: {'; '.join(several.estimates.cautions)}"
    yield (
        f"preset {options.preset}, further cameras at {', '.join(f'{a:g}' for a in options.angles)} degrees,"
        f" {changes(options)}, seeds {options.seeds.start} to {options.seeds.stop - 1}"
    )
    yield "  where     one, cm   several, cm   ratio   NEES one   NEES several"
    for kind in kinds:
        both = [np.concatenate(found[kind, number]) for number in (0, 1)]
        cm, nees = [100 * rms(each[:, 0]) for each in both], [each[:, 1].mean() for each in both]
        yield (f"  {kind:8} {cm[0]:8.2f} {cm[1]:13.2f} {cm[1] / cm[0]:7.2f} {nees[0]:10.2f} {nees[1]:14.2f}")
    if placed:
        worst = np.abs(np.array(placed))
        words = [
            f"{name} {np.median(worst[:, k]):.2f} ({worst[:, k].max():.2f})"
            for k, name in enumerate(("degrees", "cm", "ms"))
        ]
        yield f"  placed to, median (largest): {', '.join(words)}"
    yield f"  time {spent[1] / spent[0]:.2f} of one camera's"


@check(
    PRESET,
    option("--speeds", type=float, nargs="+", default=[1.0, 0.5, 0.25], help="of the arm"),
    option("--height-m", type=float, default=None, help="of the person, where it is stated"),
    seeds_option("5200:5208"),
    CHANGES,
)
def rgb(options: argparse.Namespace) -> Iterator[str]:
    """One camera without depth and a wrist IMU: the wrist's error in gaps by how fast the arm moves."""
    settings: dict[str, object] = {
        "protocol": "random",
        "duration_s": 60.0,
        "rgb": "all",
        "occlusion_lengths_s": (1.0, 2.0),
    } | changes(options)
    config = Config.model_validate({"windows": {"processes": 1}, "arm": {"height_m": options.height_m}})
    yield (
        f"preset {options.preset}, {changes(options)}, seeds {options.seeds.start} to"
        f" {options.seeds.stop - 1}, height {options.height_m or 'not stated'}"
    )
    yield "  speed   gaps, cm   worst   depth, cm   its sigma   NEES   inside 95 %   far   refused"
    for speed in options.speeds:
        found: list[np.ndarray] = []
        depths: list[tuple[float, float]] = []
        far = refused = 0
        for seed in options.seeds:
            config_of_arm = ArmSimulation.preset(options.preset, **settings, speed=speed)
            simulated = simulate_arm(config_of_arm, seed=seed)
            try:
                recovery = smooth(replace(simulated.recording, truth=None), config=config)
            except UnoccludeError as error:
                refused += 1
                yield f"  seed {seed}: {error}"
                continue
            found.append(wrist_errors(recovery, simulated, recovery.occluded))
            truth = simulated.recording.truth
            assert truth is not None
            z_m = (recovery.joints["wrist"] - truth.joints["wrist"])[:, 2]
            variance = recovery.joint_covariance["wrist"][:, 2, 2]
            depths.append((float(np.nanmean(z_m)), float(np.sqrt(np.nanmedian(variance)))))
            far += any("distance" in each for each in recovery.estimates.cautions)
        if not found:
            continue
        cm, depth = [100 * rms(each[:, 0]) for each in found], 100 * np.array(depths)
        nees = np.concatenate(found)[:, 1]
        yield (
            f"  {speed:5g} {np.sqrt(np.mean(np.square(cm))):10.2f} {max(cm):7.2f} {rms(depth[:, 0]):11.2f}"
            f" {rms(depth[:, 1]):11.2f} {nees.mean():6.2f} {100 * np.mean(nees < 7.815 / 3):13.1f}"
            f" {far:5} {refused:9}"
        )
