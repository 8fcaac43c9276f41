"""Gaps whose answer another explanation of the visible motion contradicts, and skeletons that are mirrored.

`explanations` finds what fits the visible motion as well. Here its motion is followed into every gap: the
forearm's direction turns with it, and so does the path that the IMU adds to the smooth curve between the
gap's ends, which the camera saw. No second recovery is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..measurements.remedy import AXES, Remedy
from ..measurements.segment import Segment, down_hint
from ..measurements.visibility import Gap
from ..recording import Recording
from ..result import Recovery
from ..result.verdict import finding
from ..rotation import Rotation
from .cause import distrusted, fixed_by, on_upper_arm
from .explanations import Explanation, explanations
from .trust import sensor_at_elbow

#: A mirrored skeleton that explains the visible motion better by this log-likelihood is the cause. In sound
#: trials of UTD-MHAD of 2 to 5 s it is less likely by 5 to 120, in simulated arms of 30 s by more than 12; it
#: is more likely by 6 at most where all motion in view lies exactly in one plane.
CLEARLY = 8.0
#: It has to fit by itself, too: what it leaves of the forearm's direction is less than this, rms.
FITS_RAD = np.radians(20.0)
#: A mirrored skeleton, or another mounting, that is less likely by no more than this fits about as well. The
#: attitude was fitted to the camera without the mirror, which is worth some of it.
NEARLY_MIRRORED, NEARLY_MOUNTED = 12.0, 5.0
#: Answers in a gap differ where they do so by this many sigmas, and by this much: degrees rms, m at most.
SIGMAS, APART_DEG, APART_M = 4.0, 12.0, 0.08
#: Of these limits this part counts for a mirrored skeleton, which changes the curve between a gap's ends too.
MIRRORED_PART = 0.5
#: A gap that is shorter hides nothing, s; of a longer one at most this many samples are looked at.
SHORTEST_S, MOST_SAMPLES = 0.25, 200


def with_ambiguities(
    recovery: Recovery, recording: Recording, excerpts: Sequence[Segment], given: ArmCalibration | None = None
) -> Recovery:
    """The recovery without trust in the gaps that the visible motion leaves ambiguous."""
    estimates = recovery.estimates
    is_trusted = estimates.trusted is not False
    if estimates.cause is not None:
        return recovery
    if is_trusted and (given is None or not given.lever_arms):
        for swapped in sensor_at_elbow(recording.arm, recovery.calibration):
            cause = fixed_by(swapped.sentence, (Remedy(swap=swapped.joints),), recording.applied_fixes)
            return distrusted(recovery, cause)
    if is_trusted and (upper := on_upper_arm(recording)) is not None:
        return distrusted(recovery, upper)
    found = explanations(recovery, excerpts, down_hint(recording), NEARLY_MIRRORED)
    if found is None:
        return recovery
    own, others = found
    if any(each.is_mirrored and each.cost < -CLEARLY and each.direction_rad < FITS_RAD for each in others):
        axis = _level_axis(recording)
        remedies = (Remedy(mirror=axis), Remedy(negate=("accelerometer",)))
        mistake = f"the skeleton seems mirrored ({axis}), or the accelerometer's sign seems reversed"
        return distrusted(recovery, fixed_by(mistake, remedies, recording.applied_fixes))
    if not is_trusted:
        return recovery
    others = tuple(each for each in others if each.is_mirrored or each.cost < NEARLY_MOUNTED)
    estimates = estimates.with_findings(
        finding("ambiguous", why, (gap.start_s, gap.end_s))
        for gap in recovery.gaps
        for why in _contradictions(recovery, recording, gap, own, others)
    )
    return replace(recovery, estimates=estimates)


def _contradictions(
    recovery: Recovery,
    recording: Recording,
    gap: Gap,
    own: Explanation,
    others: tuple[Explanation, ...],
) -> tuple[str, ...]:
    """The other explanations by which the arm moves elsewhere in a gap, in words; one of each kind."""
    samples = slice(*np.searchsorted(recovery.t_s, [gap.start_s, gap.end_s]).tolist())
    count = samples.stop - samples.start
    if gap.length_s < SHORTEST_S or count < 4:
        return ()
    rows = np.unique(np.linspace(samples.start, samples.stop - 1, min(count, MOST_SAMPLES)).astype(int))
    part = recovery.rows(rows)
    if not part.answered.all():
        return ()
    sigma_deg = float(np.sqrt(np.mean(part.sigma_deg**2)))
    sigma_m = float(part.worst_sigma_m.max())
    is_open = gap.open_start or gap.open_end
    deviation = np.zeros((1, 3)) if is_open else _off_the_smooth_curve(part)
    reasons: dict[bool, str] = {}
    for other in others:
        apart_deg = turned_apart_deg(part, own, other)
        apart_m = float(np.linalg.norm(deviation @ (other.Q_K - own.Q_K).T, axis=1).max())
        part_of = MIRRORED_PART if other.is_mirrored else 1.0
        limit_deg = part_of * max(SIGMAS * sigma_deg, APART_DEG)
        if apart_deg > limit_deg or apart_m > part_of * max(SIGMAS * sigma_m, APART_M):
            reasons.setdefault(other.is_mirrored, _in_words(other, own, recording))
    return tuple(reasons.values())


def turned_apart_deg(part: Recovery, own: Explanation, other: Explanation) -> float:
    """Angle between the forearm's directions by two explanations, root mean square over samples, degrees."""
    R_K_A = Rotation.from_quat(part.quaternion, scalar_first=True).as_matrix()
    one, two = ((R_K_A @ each.along_A) @ each.Q_K.T for each in (own, other))
    angle = np.arccos(np.clip((one * two).sum(axis=1), -1.0, 1.0))
    return float(np.degrees(np.sqrt(np.mean(angle**2))))


def _off_the_smooth_curve(part: Recovery) -> FloatArray:
    """(n, 3) the path less the cubic with its ends' positions and velocities, m in {K}."""
    length_s = float(part.t_s[-1] - part.t_s[0])
    u = (part.t_s - part.t_s[0]) / length_s
    late = u**2 * (3.0 - 2.0 * u)
    hermite = np.stack([1.0 - late, u * (1.0 - u) ** 2, late, u**2 * (u - 1.0)], axis=1)
    ends = np.stack(
        [part.position[0], part.velocity[0] * length_s, part.position[-1], part.velocity[-1] * length_s]
    )
    return np.asarray(part.position - hermite @ ends)


def _in_words(other: Explanation, own: Explanation, recording: Recording) -> str:
    """Why a gap is not trusted, without a full stop."""
    if not other.is_mirrored:
        degrees = np.degrees(np.arccos(np.clip(other.along_A @ own.along_A, -1.0, 1.0)))
        return (
            f"a mounting of the sensor that is {degrees:.0f} degrees off fits the visible motion about as"
            " well, and the hidden motion differs: move the arm more in view, or give a calibration"
        )
    option = f"--mirror {_level_axis(recording)}"
    if option in recording.applied_fixes:
        return (
            f"without {option} the skeleton fits the visible motion about as well, and the hidden motion"
            " differs: move the arm out of one plane in view"
        )
    return (
        "a mirrored skeleton fits the visible motion about as well, and the hidden motion differs: move the"
        f" arm out of one plane in view; if left and right may be exchanged, run again with {option}"
    )


def _level_axis(recording: Recording) -> str:
    """An axis of the camera that can be mirrored without turning gravity; all level ones are equivalent."""
    level = np.abs(down_hint(recording)) < 0.5
    return AXES[int(np.argmax(level))]
