"""Sigma for recordings that are too short to check themselves: gaps hidden in those they are calibrated on.

`smooth` hides stretches of a recording to test its sigma. A trial of a few seconds has none to
spare; many such trials of one person, camera and sensor have them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration, SigmaFactor, SigmaFactors
from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.linalg import interpolate
from smoother.recording import Recording
from smoother.runtime.pool import Pool
from smoother.smoothing import smooth

from ..sigma_factor import ENOUGH_GAPS, LARGEST_FACTOR, length_factors, needed_factors

#: A recording up to this length, s, rarely checks itself.
SHORT_S = 12.0
#: Lengths of the gaps, s; as much is left visible on both sides.
LENGTHS_S = (0.5, 1.0)
BESIDE_S = 0.6
#: Joints to compare with, the best first.
REFERENCES = ("wrist", "strap", "hand")


def short_recordings(recordings: Sequence[Recording]) -> list[Recording]:
    """Those that are too short to check themselves, if they are enough to do so together; else none."""
    short = [one for one in recordings if len(one.arm) and one.arm.t_s[-1] - one.arm.t_s[0] <= SHORT_S]
    return short if len(short) >= ENOUGH_GAPS else []


def hidden_gap_factors(
    recordings: Sequence[Recording], calibration: ArmCalibration, config: Config
) -> SigmaFactors | None:
    """What sigma of positions in gaps has to be multiplied by, from gaps hidden in short recordings.

    In each recording the middle is hidden before anything else is done, once a length; the answer is compared
    with the camera's joint, whose noise counts (`sigma_factor.length_factors`).

    Parameters
    ----------
    recordings : sequence of Recording
        Of one person, camera and mounting; see `short_recordings`.
    calibration : ArmCalibration
        Found from them.
    config : Config

    Returns
    -------
    factors : SigmaFactors or None
        None where sigma is right as stated, or too few gaps have a trusted answer.
    """
    jobs = [(recording, length_s) for length_s in LENGTHS_S for recording in recordings]
    job = partial(_needed, calibration=calibration, config=config)
    with Pool(config.windows.processes, sum(len(recording.arm) for recording, _ in jobs)) as pool:
        needed = list(pool.map(job, jobs))
    rows = length_factors([(length_s, each) for (_, length_s), each in zip(jobs, needed, strict=True)])
    rows = tuple(row for row in rows if row.count >= ENOUGH_GAPS and row.factor <= LARGEST_FACTOR)
    if not any(row.factor > 1.0 for row in rows):
        return None
    return SigmaFactors(tuple(SigmaFactor(row.length_s, row.factor, row.count) for row in rows))


def _needed(job: tuple[Recording, float], calibration: ArmCalibration, config: Config) -> FloatArray:
    """The factors (n, 2) required by the samples of one hidden gap; none where it is not recovered."""
    recording, length_s = job
    nothing = np.zeros((0, 2))
    arm = recording.arm
    middle_s = 0.5 * (arm.t_s[0] + arm.t_s[-1])
    hidden: BoolArray = np.abs(arm.t_s - middle_s) <= 0.5 * length_s
    if arm.t_s[-1] - arm.t_s[0] < length_s + 2.0 * BESIDE_S:
        return nothing
    joint = next((name for name in REFERENCES if (arm.tracked(name) & hidden).any()), None)
    if joint is None:
        return nothing
    copy = replace(recording, arm=arm.hide(hidden), truth=None)
    try:
        recovery = smooth(copy, calibration, config, processes=1)
    except UnoccludeError:
        return nothing
    noise_m = (recovery.estimates.camera_sigma_m or {}).get(joint)
    if joint not in recovery.joints or noise_m is None:
        return nothing
    seen = arm.tracked(joint) & hidden
    t = np.asarray(recovery.arm.t_s)[seen]
    inside = slice(*np.searchsorted(recovery.t_s, [t[0], t[-1]]).tolist())
    if not np.asarray(recovery.trusted[inside]).all():
        return nothing
    error = interpolate(recovery.t_s, recovery.joints[joint], t) - arm.joint(joint)[seen]
    stated = interpolate(recovery.t_s, recovery.joint_covariance[joint], t)
    return needed_factors(error, stated, noise_m**2 * np.eye(3))
