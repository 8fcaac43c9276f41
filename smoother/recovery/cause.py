"""The likeliest cause of an answer that is not to be trusted, by trying the alternatives in closed form.

Each mistake that people make is undone in turn, and camera and IMU are fitted anew (a tenth of a second). The
one that fits where the recording as it is does not (directions, accelerations, gravity, lever arms) is the
cause.

Some mistakes cannot be told apart: a mirrored skeleton and a turned accelerometer are the same motion, up to
how the camera stands. Then both are named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..body import UPPER_ARM
from ..calibration import ArmCalibration
from ..errors import CalibrationError, SolveError
from ..measurements.clock import Clock
from ..measurements.remedy import AXES, Remedy
from ..measurements.segment import down_hint
from ..recording import CameraFrame, JointState, Recording
from ..result import Recovery
from ..result.verdict import EVER, finding
from ..selfcal.excerpts import informative_recording
from ..selfcal.mounting import ClosedForm, closed_form
from ..selfcal.pairing import pair
from .trust import GRAVITY_DEG, LEVER_ARM_M, input_faults, swapped_joints

#: Of frames, at most this many are used to decide on which side of the camera the arm is.
MOST_FRAMES = 20_000
#: Degrees in a radian.
DEGREES = float(np.degrees(1.0))


@dataclass(frozen=True)
class Alternative:
    """A recording as it would have been, had one mistake not been made."""

    mistake: str  # What was wrong then, as "the skeleton seems mirrored (x)"
    corrected: Callable[[Recording], Recording]  # From the recording to the one without the mistake
    advice: str  # What to do about it
    remedy: Remedy | None = None  # The options that undo it
    kind: str = ""  # Of alternatives of one kind the first that fits is meant


ON_UPPER_ARM = Alternative(
    "the IMU seems to sit on the upper arm",
    lambda given: replace(given, arm=UPPER_ARM.seen_as_forearm(given.arm)),
    "strap it to the forearm, near the wrist",
)


def alternatives(recording: Recording) -> Iterator[Alternative]:
    """All that is tried, the likelier first."""
    for axis in AXES:
        remedy = Remedy(mirror=axis)
        if _in_front(recording, remedy):
            yield by_remedy(remedy, f"the skeleton seems mirrored ({axis})", "mirror")
    yield by_remedy(Remedy(negate=("accelerometer",)), "the accelerometer's sign seems reversed")
    yield by_remedy(Remedy(negate=("gyroscope",)), "the gyroscope's sign seems reversed")
    yield by_remedy(Remedy(negate=("accelerometer", "gyroscope")), "the sensor's axes seem left-handed")
    yield Alternative(
        "the gyroscope's rates seem 57 times too small (rad/s converted as if they were deg/s)",
        lambda given: _scaled(given, gyro=DEGREES),
        'import them again as they are (gyroscope_unit = "rad/s")',
    )
    yield Alternative(
        "the gyroscope's rates seem 57 times too large (deg/s labelled rad/s)",
        lambda given: _scaled(given, gyro=1.0 / DEGREES),
        'import them again in their unit (gyroscope_unit = "deg/s")',
    )
    for factor, words in ((1000.0, "1000 times too small"), (100.0, "100 times too small")):
        yield Alternative(
            f"the camera's positions seem {words}",
            lambda given, by=factor: _scaled(given, position=by),  # type: ignore[misc]
            "import them again in their unit (position_unit)",
        )
    yield ON_UPPER_ARM


def by_remedy(remedy: Remedy, mistake: str, kind: str = "") -> Alternative:
    """The alternative that some options undo."""
    return Alternative(mistake, remedy.applied, f"run again with {remedy.options}", remedy, kind or mistake)


def _scaled(recording: Recording, gyro: float = 1.0, position: float = 1.0) -> Recording:
    imu, arm = recording.imu, recording.arm
    imu, arm = replace(imu, gyro=imu.gyro * gyro), replace(arm, position=arm.position * position)
    return replace(recording, imu=imu, arm=arm)


def _in_front(recording: Recording, remedy: Remedy) -> bool:
    """Whether a camera that looks along z could see the arm then; any other sees it anywhere."""
    if recording.camera_frame not in (CameraFrame.KINECT, CameraFrame.OPTICAL):
        return True
    arm = recording.arm.select(slice(None, None, max(len(recording.arm) // MOST_FRAMES, 1)))
    depth_m = arm.position[..., 2][arm.state == JointState.TRACKED]
    depth_m = depth_m[np.isfinite(depth_m)]
    return not len(depth_m) or (float(np.median(depth_m)) > 0.0) != (remedy.mirror == "z")


#: The IMU was not on this forearm where nothing that was tried fits, the forearm's direction is off by more
#: than this, degrees, and this share of the acceleration is unexplained: 21 to 40 and all of it for another
#: arm.
ELSEWHERE_DEG, ELSEWHERE_SHARE = 17.0, 0.8
#: A cause leaves this part of the recording's misfit at most; one that leaves little more than the best is as
#: likely.
CLEARLY, AS_LIKELY = 0.5, 1.25
#: A convention of the camera's axes is meant where gravity points within this of its down, degrees.
SAME_DOWN_DEG = 35.0


@dataclass(frozen=True)
class Cause:
    """Why a result is not to be trusted."""

    sentence: str  # What is wrong and what to do, without a full stop
    remedies: tuple[Remedy, ...] = ()  # What undoes it, as options


def with_cause(
    recovery: Recovery, recording: Recording, given: ArmCalibration, measured: Clock | None = None
) -> Recovery:
    """A recovery with the likeliest cause first among its reasons, if it is not to be trusted."""
    estimates = recovery.estimates
    if estimates.trusted is not False or estimates.cause is not None:
        return recovery
    cause = likeliest_cause(recording, given, measured)
    return recovery if cause is None else distrusted(recovery, cause)


def distrusted(recovery: Recovery, cause: Cause) -> Recovery:
    """The recovery not to be trusted, with its cause as the first of the reasons."""
    remedies = tuple(remedy.options for remedy in cause.remedies)
    likeliest = finding("cause", cause.sentence, EVER, " or ".join(remedies))
    estimates = replace(
        recovery.estimates,
        trusted=False,
        reasons=(cause.sentence, *recovery.estimates.reasons),
        findings=(likeliest, *recovery.estimates.findings),
        cause=cause.sentence,
        remedies=remedies,
    )
    return replace(recovery, estimates=estimates)


@contextmanager
def diagnose_failures(
    recording: Recording, given: ArmCalibration, measured: Clock | None = None
) -> Iterator[None]:
    """What cannot be solved is refused with its likeliest cause."""
    try:
        yield
    except (SolveError, CalibrationError) as error:
        cause = likeliest_cause(recording, given, measured)
        if cause is None:
            raise
        raise type(error)(f"{str(error).rstrip('.')}; {cause.sentence}") from error


def likeliest_cause(
    recording: Recording, given: ArmCalibration | None = None, measured: Clock | None = None
) -> Cause | None:
    """The mistake that explains a recording on which something is wrong; None where none does."""
    for swapped in swapped_joints(recording.arm):
        return fixed_by(swapped.sentence, (Remedy(swap=swapped.joints),), recording.applied_fixes)
    recorded, recording = recording, informative_recording(recording)
    hint = down_hint(recording)
    down = hint if hint.any() else None
    as_it_is = closed_form(recording, given)
    if as_it_is is None or not np.isfinite(as_it_is.misfit):
        return None
    if as_it_is.fits:
        upper = _on_upper_arm(recording, as_it_is)
        return upper if upper or down is None else _wrong_gravity(as_it_is, recording, down)
    if measured is not None and _fits_without(recording, measured, given, as_it_is):
        return Cause(
            "the clock that was given does not fit, but the one by motion does: it is likely to be of"
            " another session; run again without --clock-offset and without [clock] in the calibration"
        )
    if given is not None and given.lever_arms:
        alone = closed_form(recording)
        if alone is not None and alone.fits and alone.misfit < CLEARLY * as_it_is.misfit:
            return Cause(
                "the calibration seems to be of another person or mounting: the recording fits without it;"
                " run again without --calibration, or calibrate this mounting"
            )
    candidates = [*_that_fit(recording, down, as_it_is), *_other_arm(recorded, as_it_is)]
    if candidates:
        return _named(candidates, recording.applied_fixes)
    is_elsewhere = as_it_is.direction_deg > ELSEWHERE_DEG and as_it_is.acceleration_share > ELSEWHERE_SHARE
    if is_elsewhere and not any(input_faults(recording)):
        return Cause(
            "the IMU does not turn with this forearm, and no mirroring, sign, unit or clock explains it:"
            " the skeleton seems to be of the other arm or of another recording, or the IMU was worn"
            " elsewhere; check --side, --imu and the files"
        )
    return None


def on_upper_arm(recording: Recording) -> Cause | None:
    """The IMU turns with the upper arm, however well it fits the forearm: with the elbow hardly bent, say."""
    recording = informative_recording(recording)
    as_it_is = closed_form(recording)
    return None if as_it_is is None else _on_upper_arm(recording, as_it_is)


def _on_upper_arm(recording: Recording, as_it_is: ClosedForm) -> Cause | None:
    fit = closed_form(ON_UPPER_ARM.corrected(recording))
    if fit is None or not fit.fits or fit.misfit >= as_it_is.misfit:
        return None
    shoulder, elbow = (fit.calibration.lever_arms[joint].position_m for joint in ("elbow", "wrist"))
    if (
        elbow @ (elbow - shoulder) < 0.0
    ):  # beyond the elbow: an arm that stays straight fits both, and its lever arm tells
        return None
    return _named([(fit.misfit, ON_UPPER_ARM)], recording.applied_fixes)


def _other_arm(recording: Recording, as_it_is: ClosedForm) -> Iterator[tuple[float, Alternative]]:
    """Misfit and alternative where the IMU turns with the person's other forearm, whatever its clock."""
    if recording.opposite is None:
        return
    exchanged = by_remedy(Remedy(sides=True), "left and right of the skeleton seem exchanged")
    try:
        fit = closed_form(pair(exchanged.corrected(recording))[0])
    except CalibrationError:  # the motion does not show the clock
        return
    if fit is not None and fit.fits and fit.misfit < CLEARLY * as_it_is.misfit:
        yield fit.misfit, exchanged


def _fits_without(
    recording: Recording, measured: Clock, given: ArmCalibration | None, as_it_is: ClosedForm
) -> bool:
    """The motion's own clock fits clearly better than the one that was given."""
    stamps = recording.arm.t_s - measured.at(recording.arm.t_s - measured.mean_s)
    try:
        recorded = replace(recording, arm=replace(recording.arm, t_s=stamps))
        fit = closed_form(pair(recorded)[0], given)
    except CalibrationError:  # the motion does not say
        return False
    return fit is not None and fit.fits and fit.misfit < CLEARLY * as_it_is.misfit


def _wrong_gravity(fit: ClosedForm, recording: Recording, down: FloatArray) -> Cause | None:
    """Everything fits but gravity: the axes' convention is another, or slow motion hides what is wrong."""
    if not fit.down_deg(down) > GRAVITY_DEG:
        return None
    candidates = _that_fit(recording, down, fit)
    if candidates:
        return _named(candidates, recording.applied_fixes)
    others = (frame for frame in CameraFrame if frame is not recording.camera_frame)
    frames = [frame for frame in others if fit.down_deg(frame.down) < SAME_DOWN_DEG]
    if recording.gravity_hint is not None or not frames:
        return Cause(
            "camera and IMU fit together, but not with the direction of gravity stated in the recording;"
            " check the camera's orientation"
        )
    remedy = Remedy(camera_frame=frames[0])
    return Cause(
        f"the camera's axes seem to be {frames[0]}, not {recording.camera_frame}; run again with"
        f" {remedy.options}",
        (remedy,),
    )


def _that_fit(
    recording: Recording, down: FloatArray | None, as_it_is: ClosedForm
) -> list[tuple[float, Alternative]]:
    """Misfit and alternative of those that fit clearly better, the first of each kind."""
    fitting: list[tuple[float, Alternative]] = []
    for alternative in alternatives(recording):
        if alternative.kind and any(alternative.kind == other.kind for _, other in fitting):
            continue
        fit = closed_form(alternative.corrected(recording))
        if fit is None or not fit.fits or fit.misfit > CLEARLY * as_it_is.misfit:
            continue
        if down is not None and fit.down_deg(down) > GRAVITY_DEG:
            continue
        if all(
            np.linalg.norm(lever.position_m) < LEVER_ARM_M for lever in fit.calibration.lever_arms.values()
        ):
            fitting.append((fit.misfit, alternative))
    return fitting


def _named(candidates: list[tuple[float, Alternative]], given: tuple[str, ...]) -> Cause:
    """The best alternative, and those that are as likely."""
    best = min(misfit for misfit, _ in candidates)
    likely = [alternative for misfit, alternative in candidates if misfit < AS_LIKELY * best]
    remedies = tuple(each.remedy for each in likely if each.remedy is not None)
    mistake = ", or ".join(each.mistake for each in likely)
    if len(remedies) == len(likely):
        return fixed_by(mistake, remedies, given)
    return Cause(f"{mistake}; {'; or '.join(each.advice for each in likely)}", remedies)


def fixed_by(mistake: str, remedies: tuple[Remedy, ...], given: tuple[str, ...]) -> Cause:
    """A mistake that an option undoes; where that very option was given, it is what made the mistake."""
    made = [remedy.options for remedy in remedies if remedy.options in given]
    if made:
        return Cause(f"with {made[0]} {mistake}; run again without {made[0]}")
    return Cause(f"{mistake}; run again with {' or '.join(each.options for each in remedies)}", remedies)
