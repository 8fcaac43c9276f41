"""Whether a recovery can be what happened: anatomy, gravity, clock, rates, and what the camera sees of it.

A wrong set-up (a mirrored skeleton, the other arm's joints, a sensor elsewhere, an accelerometer of the other
sign) gives an answer all the same, and its sigma holds only if the model does. Each sign here is cheap, and
far from what sound recordings show; an answer that shows one is not to be trusted, whatever its sigma says.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..config import Anatomy
from ..error_radius import within_words
from ..linalg import robust_sigma
from ..measurements.clock import LARGEST_OFFSET_S, Clock
from ..measurements.visibility import Rejection
from ..recording import FOREARM_JOINTS, JOINTS, CameraFrame, JointTracks, Recording
from ..result import Recovery, SelfCheck
from ..result.verdict import EVER, Finding, finding, gap_verdicts
from .change_signs import imu_lies_still, skeleton_filled
from .imu_signs import (
    PLATEAU_SHARE,
    SLOW_HZ,
    TOO_SLOW_HZ,
    clipped,
    doubtful_scale,
    force_scale,
    input_faults,
    lost_samples,
    paused_in_gaps,
    rate,
    spikes,
    wrong_scale,
    zeros,
)
from .lone_camera import distance_doubtful, distance_unknown

#: A bone's length varies less than this, m, and less than this part of what is not a bone: upper arms vary by
#: 0.01 to 0.03, shoulder to wrist by 0.06 to 0.12 as the elbow bends.
BONE_SIGMA_M, BONE_PART = 0.05, 0.4
FEWEST_FRAMES, MOST_FRAMES = 50, 20_000
#: A hand is some 0.08 m from the wrist and 0.3 m from the elbow.
NEARER = 0.6
#: From the elbow the hand is 1.24 times as far as the wrist in the median of 670 arms of a Kinect v1, 1.02
#: times at least.
HAND_NEARER = 0.93
#: A sensor nearer to the joint called elbow than to the wrist by this, m, and by this many sigmas, is on
#: a forearm whose joints are exchanged; unless the camera shows the names to be right: the wrist's distance
#: from the shoulder varies by this, m, and the elbow's by less than this part of it.
NEARER_M, NEARER_SIGMAS = 0.05, 4.0
BENT_M, STEADY_PART = 0.025, 0.7


class SwappedJoints(NamedTuple):
    """Two joints whose names seem exchanged, and what shows it, in words."""

    joints: tuple[str, str]
    sentence: str


SWAPPED = SwappedJoints(
    ("elbow", "wrist"),
    "elbow and wrist seem swapped: from the shoulder the wrist keeps its distance, and the elbow does not",
)
HAND_AT_ELBOW = SwappedJoints(
    ("elbow", "wrist"), "elbow and wrist seem swapped: the hand is nearer to the elbow than to the wrist"
)
SENSOR_AT_ELBOW = SwappedJoints(
    ("elbow", "wrist"),
    "elbow and wrist seem swapped: the sensor moves as if it were near the joint named elbow",
)
HAND_BEFORE_WRIST = SwappedJoints(
    ("wrist", "hand"), "wrist and hand seem swapped: the hand is nearer to the elbow than the wrist is"
)


def swapped_joints(arm: JointTracks) -> Iterator[SwappedJoints]:
    """Where the joint called wrist is as far from the shoulder as only an elbow is, or the hand at the one
    called elbow, or between elbow and wrist.
    """
    step = max(len(arm) // MOST_FRAMES, 1)
    arm = arm.select(slice(None, None, step))
    elbow_m, wrist_m = (_distances(arm, "shoulder", joint) for joint in ("elbow", "wrist"))
    to_elbow_m, to_wrist_m = (_distances(arm, "hand", joint) for joint in ("elbow", "wrist"))
    if _variation(elbow_m) > BONE_SIGMA_M and _variation(wrist_m) < BONE_PART * _variation(elbow_m):
        yield SWAPPED
    elif _middle(to_elbow_m) < NEARER * _middle(to_wrist_m):
        yield HAND_AT_ELBOW
    elif _middle(to_elbow_m) < HAND_NEARER * _middle(_distances(arm, "elbow", "wrist")):
        yield HAND_BEFORE_WRIST


def sensor_at_elbow(arm: JointTracks, found: ArmCalibration | None) -> Iterator[SwappedJoints]:
    """Where the sensor sits at the joint called elbow, and the camera does not show that it is one."""
    levers = {} if found is None else found.lever_arms
    if not {"elbow", "wrist"} <= set(levers):
        return
    elbow, wrist = levers["elbow"], levers["wrist"]
    nearer_m = float(np.linalg.norm(wrist.position_m) - np.linalg.norm(elbow.position_m))
    sigma_m = float(np.hypot(elbow.sigma_m, wrist.sigma_m).max())
    if not nearer_m > max(NEARER_M, NEARER_SIGMAS * sigma_m):
        return
    arm = arm.select(slice(None, None, max(len(arm) // MOST_FRAMES, 1)))
    steady_m, bent_m = (_variation(_distances(arm, "shoulder", joint)) for joint in ("elbow", "wrist"))
    to_elbow_m, to_wrist_m = (_middle(_distances(arm, "hand", joint)) for joint in ("elbow", "wrist"))
    names_are_right = (bent_m > BENT_M and steady_m < STEADY_PART * bent_m) or (
        to_wrist_m < NEARER * to_elbow_m
    )
    if not names_are_right:
        yield SENSOR_AT_ELBOW


def _distances(arm: JointTracks, first: str, second: str) -> FloatArray:
    """Between two joints where both are tracked, m; none where that was hardly the case."""
    both = arm.tracked(first) & arm.tracked(second)
    if np.count_nonzero(both) < FEWEST_FRAMES:
        return np.zeros(0)
    return np.linalg.norm((arm.joint(second) - arm.joint(first))[both], axis=1)


def _middle(distances_m: FloatArray) -> float:
    return float(np.median(distances_m)) if len(distances_m) else float("nan")


def _variation(distances_m: FloatArray) -> float:
    """How much a distance varies, m; nan where it is not known."""
    return float(robust_sigma(distances_m - _middle(distances_m))) if len(distances_m) else float("nan")


#: Lengths of the upper arm and of the forearm, joint to joint as cameras place them, m; children from three
#: years on.
UPPER_ARM_M = {Anatomy.ADULT: (0.20, 0.40), Anatomy.CHILD: (0.12, 0.36)}
FOREARM_M = {Anatomy.ADULT: (0.17, 0.34), Anatomy.CHILD: (0.10, 0.30)}
#: A sensor on a forearm is no farther from the bone's axis, m, and no lever arm is longer than the second.
FROM_AXIS_M, LEVER_ARM_M = 0.10, 0.45
#: Gravity farther than this from where the camera's frame has down is not a tilted camera, degrees.
GRAVITY_DEG = 60.0
#: A frame (or one axis) fits where its down is nearer to gravity than this, degrees: cameras tilt a little.
FRAME_DEG = 40.0
#: Where the camera sees a joint, the answer is nearer than this in half of the frames, m: simulated arms stay
#: below 0.03, the wrists of simulated Azure Kinects (54 mm rms) below 0.055, Kinect v1 with synthetic stamps
#: below 0.08, wrong set-ups begin at 0.1.
NEAR_M, FAR_M = 0.06, 0.08
#: A joint's own noise is less, m per axis.
JOINT_SIGMA_M = 0.05
#: Where more of the tracked samples are rejected, camera and IMU contradict each other.
REJECTED_SHARE = 0.30
#: A measured clock is contradicted where the motion moves it by this many of its sigmas and by this time, s.
MEASURED_SIGMAS, MEASURED_S = 4.0, 0.01
#: Elbow to "wrist" against the upper arm, and in m, from here on: the wrist is likely to be the hand
#: (Kinect v1: 0.79 to 0.99 to the wrist, 0.94 to 1.23 to the hand).
HAND_RATIO, HAND_M = 1.02, 0.32
#: A shorter gap hides nothing that a verdict could rest on, s.
SHORTEST_GAP_S = 0.25
#: More hidden stretches than this share may not fail.
FAILED_SHARE = 0.25


#: A gap says nothing of where the arm was when 95 of 100 errors reach as far as an arm does, m: from shoulder
#: to grip it is 0.665 in the median of men (Pheasant, Bodyspace).
NOWHERE_M = 0.65


def with_verdict(
    recovery: Recovery,
    recording: Recording,
    anatomy: Anatomy,
    misfits: tuple[str, ...] = (),
    open_questions: tuple[str, ...] = (),
    steps: Sequence[Finding] = (),
    measured: Clock | None = None,
    moved: Clock | None = None,
) -> Recovery:
    """The recovery with a verdict among its estimates."""
    imu, bias = recording.imu, _gyroscope_bias(recovery)
    scale, pairing, arm = force_scale(imu, bias), recovery.estimates.pairing, recovery.calibration
    # what is wrong with the input comes before what follows of it
    against_all = {
        "imu-slow": rate(imu, TOO_SLOW_HZ),
        "imu-zeros": zeros(imu),
        "imu-clipped": clipped(imu, PLATEAU_SHARE),
        "imu-scale": wrong_scale(scale),
        "options-cancel": _mirror_image(recording),
        "joints-swapped": (swapped.sentence for swapped in swapped_joints(recording.arm)),
        "no-pair": [pairing.reason] if pairing and pairing.reason else [],
        "calibration-contradicted": misfits,
        "clock-contradicted": _measured_clock(recovery, measured),
    }
    still = imu_lies_still(recovery, recording, bias)
    of_some_times = (*steps, *lost_samples(recovery, recording), *still, *_nowhere(recovery))
    further_against_all = {
        "impossible-length": _anatomy(arm, anatomy),
        "gravity": _gravity(recovery, recording),
        "distance-unknown": distance_unknown(recovery),
        "clock-limit": _clock(recovery, moved),
        "camera-elsewhere": _camera(recovery, FAR_M),
        "self-check": _self_check(recovery.estimates.self_check),
    }
    remarks = {
        "pair-unproved": [pairing.caution] if pairing and pairing.caution else [],
        "mounting-open": open_questions,
        "distance-doubtful": distance_doubtful(recovery),
        "camera-elsewhere": _camera(recovery, NEAR_M),
        "imu-slow": rate(imu, SLOW_HZ),
        "hand-as-wrist": _hand_as_wrist(arm, anatomy),
        "imu-clipped": clipped(imu, 0.0),
        "imu-scale": doubtful_scale(scale),
        "imu-spikes": spikes(imu),
        "imu-paused": paused_in_gaps(recording),
        "skeleton-filled": skeleton_filled(recovery),
    }
    found = [
        *_rows(against_all, EVER),
        *of_some_times,
        *_rows(further_against_all, EVER),
        *_rows(remarks, None),
    ]
    reasons = [each.sentence for each in found if each.severity == "recording"]
    if reasons:  # what else is wrong with the input is the likeliest cause
        faults = list(_rows({"imu-fault": input_faults(recording)}, EVER))
        found = [*faults, *(each for each in found if each.sentence not in {one.sentence for one in faults})]
    estimates = replace(recovery.estimates, trusted=True, reasons=()).with_findings(found)
    cautions = (each for each in dict.fromkeys(estimates.cautions) if each not in estimates.reasons)
    return replace(recovery, estimates=replace(estimates, cautions=tuple(cautions)))


def _rows(
    sentences: Mapping[str, Iterable[str]], contradicts_s: tuple[float, float] | None
) -> Iterator[Finding]:
    """Findings of one severity from their sentences by code."""
    return (finding(code, each, contradicts_s) for code, some in sentences.items() for each in some)


def with_gap_verdicts(recovery: Recovery) -> Recovery:
    """The recovery with the verdict that its gaps ask for: none to be trusted, or some of them only."""
    estimates = recovery.estimates
    verdicts = gap_verdicts(recovery.gaps, True, (), estimates.untrusted)
    doubtful_gaps = [each for each in verdicts if not each.trusted]
    if estimates.trusted is False or not doubtful_gaps:
        return recovery
    whole = [each for each in verdicts if each.end_s - each.start_s >= SHORTEST_GAP_S]
    if whole and not any(each.trusted for each in whole):
        reasons = tuple(dict.fromkeys(why for each in doubtful_gaps for why in each.reasons))
        estimates = replace(estimates, trusted=False, reasons=reasons)
    else:
        numbers = [str(number) for number, each in enumerate(verdicts, start=1) if not each.trusted]
        which = (
            f"gaps {', '.join(numbers[:-1])} and {numbers[-1]} are" if numbers[1:] else f"gap {numbers[0]} is"
        )
        estimates = replace(estimates, cautions=(f"{which} not to be trusted", *estimates.cautions))
    return replace(recovery, estimates=estimates)


def _nowhere(recovery: Recovery) -> Iterator[Finding]:
    """Gaps in which the answer may as well be anywhere that an arm reaches."""
    radius_m = recovery.error_95_m
    for gap in recovery.gaps:
        own = radius_m[slice(*np.searchsorted(recovery.t_s, [gap.start_s, gap.end_s]).tolist())]
        own = own[np.isfinite(own)]
        if len(own) and (usual_m := float(np.median(own))) > NOWHERE_M:
            sentence = f"nothing shows where the arm was: it is stated {within_words(usual_m)}"
            yield finding("gap-open", sentence, (gap.start_s, gap.end_s))


def _self_check(check: SelfCheck | None) -> Iterator[str]:
    """Hidden stretches that were not recovered: as large a share as gaps would be."""
    if check is not None and check.failed > max(1, FAILED_SHARE * check.stretches):
        yield (
            f"{check.failed} of {check.stretches} visible stretches that were hidden as a test could not be"
            " recovered within the stated sigma"
        )


def _mirror_image(recording: Recording) -> Iterator[str]:
    """Two remedies of one sign: together they make the motion its mirror image, which fits as well."""
    mirrored = next((option for option in recording.applied_fixes if option.startswith("--mirror ")), None)
    if mirrored and "--negate accelerometer" in recording.applied_fixes:
        yield (
            f"{mirrored} and --negate accelerometer correct the same sign, and together they mirror the whole"
            " motion, which no recording can show: give only one of the two, or neither"
        )


def _gyroscope_bias(recovery: Recovery) -> FloatArray:
    bias = np.array(recovery.estimates.gyroscope_bias or (0.0, 0.0, 0.0))
    return np.where(np.isfinite(bias), bias, 0.0)


def _anatomy(arm: ArmCalibration | None, anatomy: Anatomy) -> Iterator[str]:
    """Lengths that no arm has, each farther outside than twice its sigma."""
    if arm is None or anatomy is Anatomy.ANY:
        return
    if arm.upper_arm is not None:
        length = arm.upper_arm
        yield from _outside(length.value_m, length.sigma_m, UPPER_ARM_M[anatomy], "the upper arm is")
    levers = arm.lever_arms
    if "elbow" in levers and "wrist" in levers:
        elbow, wrist = levers["elbow"], levers["wrist"]
        along = wrist.position_m - elbow.position_m
        length_m = float(np.linalg.norm(along))
        sigma_m = float(np.hypot(elbow.sigma_m, wrist.sigma_m).max())
        yield from _outside(length_m, sigma_m, FOREARM_M[anatomy], "elbow and wrist are")
        across = wrist.position_m - (wrist.position_m @ along) * along / length_m**2
        away_m = float(np.linalg.norm(across))
        yield from _outside(
            away_m, sigma_m, (0.0, FROM_AXIS_M), "the IMU's distance from the forearm's axis is"
        )
    for joint, lever in levers.items():
        length_m = float(np.linalg.norm(lever.position_m))
        if length_m > LEVER_ARM_M + 2.0 * float(lever.sigma_m.max()):
            yield f"the IMU seems {100 * length_m:.0f} cm away from the {joint}"


def _hand_as_wrist(arm: ArmCalibration | None, anatomy: Anatomy) -> Iterator[str]:
    """A forearm that reaches to the hand, where no joint is called the hand."""
    if arm is None or anatomy is Anatomy.ANY or "hand" in arm.lever_arms or arm.upper_arm is None:
        return
    if not {"elbow", "wrist"} <= set(arm.lever_arms):
        return
    forearm_m = float(np.linalg.norm(arm.lever_arms["wrist"].position_m - arm.lever_arms["elbow"].position_m))
    upper_m = arm.upper_arm.value_m
    if forearm_m > HAND_RATIO * upper_m or (forearm_m > HAND_M and anatomy is Anatomy.ADULT):
        yield (
            f"elbow and wrist are {100 * forearm_m:.0f} cm apart with an upper arm of {100 * upper_m:.0f} cm:"
            " is the hand labelled as the wrist?"
        )


def _outside(value_m: float, sigma_m: float, limits_m: tuple[float, float], what: str) -> Iterator[str]:
    least, most = limits_m
    if not least - 2.0 * sigma_m <= value_m <= most + 2.0 * sigma_m:
        allowed = f"{100 * least:.0f} to {100 * most:.0f} cm" if least > 0 else f"at most {100 * most:.0f} cm"
        yield f"{what} {100 * value_m:.0f} cm (possible: {allowed})"


def _gravity(recovery: Recovery, recording: Recording) -> Iterator[str]:
    """Gravity that does not point where the camera's frame, or a base IMU, has down."""
    down = recording.gravity_hint
    if down is None and recording.camera_frame is not None:
        down = recording.camera_frame.down
    if down is None or not np.isfinite(recovery.gravity_direction).all():
        return
    cosine = float(recovery.gravity_direction @ down / np.linalg.norm(down))
    angle_deg = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    if angle_deg > GRAVITY_DEG:
        yield (
            f"gravity was found {angle_deg:.0f} degrees from the camera's stated down: the camera's frame,"
            " the accelerometer's sign or the skeleton's axes are likely to be wrong"
            f"{_fitting_frame(recovery.gravity_direction, recording)}"
        )


def _fitting_frame(gravity: FloatArray, recording: Recording) -> str:
    """Which convention of axes has down where gravity was found, for the end of the sentence."""
    cosines = {frame: float(gravity @ frame.down) for frame in CameraFrame}
    best = max(cosines, key=lambda frame: cosines[frame])
    stated = "" if recording.camera_frame is None else f" instead of {recording.camera_frame}"
    fits = cosines[best] > np.cos(np.radians(FRAME_DEG)) and best is not recording.camera_frame
    if fits and recording.gravity_hint is None:
        return f"; gravity fits the frame {best}{stated}"
    axis = int(np.abs(gravity).argmax())
    if abs(gravity[axis]) > np.cos(np.radians(FRAME_DEG)):
        sign = "-" if gravity[axis] < 0 else ""
        return f"; down is about {sign}{'xyz'[axis]} of the positions"
    return ""


def _clock(recovery: Recovery, moved: Clock | None) -> Iterator[str]:
    """An offset that stopped at the end of the fine search, which begins where the stamps were moved to."""
    if not len(recovery.arm):
        return
    camera_t = recovery.arm.t_s - recovery.clock_offset_s
    fine_s = recovery.clock_offset_s - (0.0 if moved is None else float(moved.at(camera_t).mean()))
    if abs(abs(fine_s) - LARGEST_OFFSET_S) < 0.01 * LARGEST_OFFSET_S:
        yield (
            f"the clocks' offset stopped at the search's limit of {1e3 * LARGEST_OFFSET_S:.0f} ms: they are"
            " likely to be farther apart"
        )


def _measured_clock(recovery: Recovery, measured: Clock | None) -> Iterator[str]:
    """A clock that was given, and that the motion contradicts."""
    if measured is None or not len(recovery.arm):
        return
    camera_t = recovery.arm.t_s - recovery.clock_offset_s
    moved_s = recovery.clock_offset_s - float(measured.at(camera_t).mean())
    if abs(moved_s) > max(MEASURED_SIGMAS * measured.sigma_s, MEASURED_S):
        yield (
            f"the motion moves the clock that was given by {1e3 * abs(moved_s):.0f} ms: it is likely to be of"
            " another session; run again without --clock-offset and without [clock] in the calibration"
        )


def _camera(recovery: Recovery, far_m: float) -> Iterator[str]:
    """Joints that the camera sees elsewhere, or too noisily, or mostly contradicted by the answer."""
    residuals = recovery.residuals
    if residuals is None:
        return
    step = max(len(residuals) // MOST_FRAMES, 1)
    residual, used = residuals.residual[::step], residuals.used[::step]
    reason = residuals.reason[::step]
    rejected = (reason != Rejection.NONE) & (reason != Rejection.INTERPOLATED)
    for joint in FOREARM_JOINTS:
        column = JOINTS.index(joint)
        size = np.linalg.norm(residual[(used | rejected)[:, column], column], axis=1)
        size = size[np.isfinite(size)]
        if len(size) > 20 and float(np.median(size)) > far_m:
            yield f"the solution deviates by {100 * np.median(size):.0f} cm from the camera's {joint}"
    for joint, sigma_m in (recovery.estimates.camera_sigma_m or {}).items():
        if sigma_m > JOINT_SIGMA_M:
            yield f"the camera's {joint} scatters by {100 * sigma_m:.0f} cm about the solution"
    tracked = used | rejected
    if tracked.sum() > 20 and rejected.sum() > REJECTED_SHARE * tracked.sum():
        share = 100.0 * rejected.sum() / tracked.sum()
        yield f"{share:.0f} % of what the camera tracked contradicts the IMU"
