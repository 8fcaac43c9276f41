"""Gaps whose answer another explanation of the visible motion contradicts, and skeletons that are mirrored.

An explanation is an orthogonal matrix Q and a direction f of the forearm in the sensor: in every frame the
forearm points along `Q R_K_A f`, and a joint accelerates by Q times what the IMU says. `R_K_A` is the
answer's own attitude: the answer itself is Q = 1, and an inertial attitude's drift is gone. Where det Q = 1
the sensor is mounted otherwise; where det Q = -1 the skeleton is mirrored. Motion in one plane allows both.

Where two explanations fit the visible motion about equally well, and the hidden motion differs between them,
nothing in the recording decides between them. Both likelihoods need only second moments of what was seen, so
all directions f are tried at once, in some milliseconds; none is solved in full. Into a gap each is followed:
the forearm's direction turns with it, and so does the path that the IMU adds to the smooth curve between the
gap's ends, which the camera saw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..calibration import ArmCalibration
from ..linalg import nearest, nearest_rotation, sphere, unit, upright
from ..measurements.alignment import acceleration_pairs
from ..measurements.inertial import InertialAttitude
from ..measurements.remedy import AXES, Remedy
from ..measurements.segment import Segment, down_hint
from ..measurements.visibility import Gap
from ..recording import JOINTS, Recording
from ..result import Recovery
from ..result.verdict import finding
from ..rotation import Rotation
from .cause import distrusted, fixed_by, on_upper_arm
from .trust import sensor_at_elbow

#: Directions of the forearm that the search starts from, and its steps.
STARTS, STEPS = 30, 12
#: Frames that are looked at, and attitudes, Hz.
FRAME_RATE_HZ, ATTITUDE_RATE_HZ = 10.0, 120.0
#: Fewer directions of the forearm decide nothing.
FEWEST_FRAMES = 12
#: How far a camera is tilted from what its frame has as down, one sigma, rad.
DOWN_SIGMA_RAD = np.radians(15.0)
#: How long a joint's lever arm is beyond the answer's, one sigma per axis, m.
LEVER_SIGMA_M = 0.10
#: Residuals are taken to scatter by this at least, rad and m/s^2.
LEAST_RAD, LEAST_ACCELERATION = np.radians(3.0), 0.15
#: Attitudes farther apart in time are not bridged, s.
BRIDGED_S = 0.3
#: Explanations nearer to each other than this are one, rad; one nearer to the answer than that, which sigma
#: covers, is the answer.
SAME_RAD, OWN_RAD = np.radians(8.0), np.radians(25.0)
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


@dataclass(frozen=True)
class Explanation:
    """What camera and IMU may have seen."""

    Q_K: FloatArray  # (3, 3): orthogonal: from the answer's directions in {K} to this one's
    along_A: FloatArray  # (3,): the forearm's direction in the sensor
    cost: float  # Negative log-likelihood of what was seen, up to a constant
    direction_rad: float = 0.0  # Root mean square angle of the forearm that it leaves

    @property
    def is_mirrored(self) -> bool:
        """It has the skeleton as a mirror image."""
        return bool(np.linalg.det(self.Q_K) < 0.0)

    def apart_rad(self, other: Explanation) -> float:
        """How far this explanation's axes or its forearm are from another's of the same kind, rad."""
        turn = float(np.arccos(np.clip(0.5 * (np.trace(self.Q_K @ other.Q_K.T) - 1.0), -1.0, 1.0)))
        mount = float(np.arccos(np.clip(self.along_A @ other.along_A, -1.0, 1.0)))
        return max(turn, mount)


@dataclass(frozen=True)
class Seen:
    """What the camera saw beside its prediction from the answer's attitude and the IMU."""

    along_K: FloatArray  # (n, 3): the forearm's direction by the camera
    R_K_A: FloatArray  # (n, 3, 3): the answer's attitude at these frames
    acc_K: FloatArray  # (m, 3) m/s^2: A joint's acceleration by the camera
    imu_K: FloatArray  # (m, 3) m/s^2: the IMU's by itself, in the answer's axes
    turn_K: FloatArray  # (m, 3, 3) 1/s^2: what a lever arm in {A} adds to it
    lever_A: FloatArray  # (3,) m: of that joint in the answer


def seen(recovery: Recovery, excerpts: Sequence[Segment]) -> Seen | None:
    """What was seen in some excerpts; None where that does not determine the mounting."""
    arm, residuals = recovery.calibration, recovery.residuals
    if arm is None or residuals is None or arm.forearm_direction is None:
        return None
    joint = next((joint for joint in ("wrist", "hand", "elbow") if joint in arm.lever_arms), "")
    elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
    down = recovery.gravity_direction
    S_W_K = upright(-down).T if np.isfinite(down).all() else np.eye(3)
    parts: list[tuple[FloatArray, ...]] = []
    for excerpt in excerpts:
        attitude = _attitude(recovery, excerpt, S_W_K)
        if attitude is None:
            continue
        frames = residuals.rows(excerpt.frames)
        position = np.asarray(recovery.arm.position[excerpt.frames])
        inside = (frames.t_s >= excerpt.start_s) & (frames.t_s <= excerpt.end_s)
        inside &= np.abs(attitude.t[nearest(attitude.t, frames.t_s)] - frames.t_s) < BRIDGED_S
        both = _thinned(frames.t_s, inside & frames.used[:, elbow] & frames.used[:, wrist])
        along = unit(position[both, wrist] - position[both, elbow])
        R_K_A = S_W_K.T @ attitude.at(frames.t_s[both]).as_matrix()
        column = JOINTS.index(joint)
        rows = inside & frames.used[:, column]
        found = acceleration_pairs(frames.t_s[rows], position[rows, column], attitude, excerpt.signal)
        assert found.turn is not None
        parts.append((along, R_K_A, found.in_K, found.in_E @ S_W_K, S_W_K.T @ found.turn))
    if sum(len(part[0]) for part in parts) < FEWEST_FRAMES:
        return None
    together = [np.concatenate(column) for column in zip(*parts, strict=True)]
    along_K, turned, acc_K, imu_K, turn_K = together
    return Seen(along_K, turned, acc_K, imu_K, turn_K, arm.lever_arms[joint].position_m)


def _attitude(recovery: Recovery, excerpt: Segment, S_W_K: FloatArray) -> InertialAttitude | None:
    """The answer's attitude over an excerpt; None where there is hardly any."""
    t = recovery.t_s
    first, last = np.searchsorted(t, [excerpt.start_s, excerpt.end_s]).tolist()
    if last - first < 2:
        return None
    step = max(int((last - first) / (t[last - 1] - t[first]) / ATTITUDE_RATE_HZ), 1)
    rows = slice(first, last, step)
    quaternion = np.asarray(recovery.quaternion[rows])
    answered = np.isfinite(quaternion).all(axis=1)
    if answered.sum() < FEWEST_FRAMES:
        return None
    R_K_A = Rotation.from_quat(quaternion[answered], scalar_first=True).as_matrix()
    return InertialAttitude(t[rows][answered], Rotation.from_matrix(S_W_K @ R_K_A), np.zeros(3))


def _thinned(t: FloatArray, mask: BoolArray) -> IntArray:
    """Rows of a mask, at most `FRAME_RATE_HZ`."""
    rows = np.flatnonzero(mask)
    _, first = np.unique(np.floor(t[rows] * FRAME_RATE_HZ), return_index=True)
    return rows[first]


class Likelihood:
    """The cost of any explanation, from second moments of what was seen."""

    def __init__(
        self, what: Seen, own: tuple[FloatArray, FloatArray, FloatArray], gravity: FloatArray
    ) -> None:
        """With the scatter that an explanation (Q, f, l) leaves, and gravity's part (3, 3) of the profile."""
        Q, f, lever = own
        direction = what.along_K - (what.R_K_A @ f) @ Q.T
        weight_d = 2.0 * effective_count(direction) / _mean_square(direction, LEAST_RAD * np.sqrt(2.0))
        by_camera, count_a, each_a = what.acc_K, len(what.acc_K), 0.0
        if count_a:
            left = by_camera - (what.imu_K + what.turn_K @ lever) @ Q.T
            each_a = 3.0 * effective_count(left) / _mean_square(left, LEAST_ACCELERATION * np.sqrt(3.0))
            each_a /= count_a
        prior = np.eye(3) / LEVER_SIGMA_M**2
        turned = what.R_K_A.reshape(-1, 9) / len(what.R_K_A)
        self.directions = weight_d * (what.along_K.T @ turned).reshape(3, 3, 3)
        self.accelerations = each_a * by_camera.T @ what.imu_K + gravity
        self.by_lever = each_a * np.einsum("ni,njk->ijk", by_camera, what.turn_K)
        # the quadratic form in l that does not depend on Q
        self.lever_matrix = each_a * np.einsum("nji,njk->ik", what.turn_K, what.turn_K) + prior
        self.lever_vector = prior @ what.lever_A - each_a * np.einsum("nji,nj->i", what.turn_K, what.imu_K)
        self.constant = weight_d + float(np.linalg.norm(gravity))
        self.constant += 0.5 * each_a * float((by_camera**2).sum() + (what.imu_K**2).sum())
        self.constant += 0.5 * float(what.lever_A @ prior @ what.lever_A)

    def lowest(
        self, f: FloatArray, lever: FloatArray, signs: Sequence[float] = (1.0, -1.0), steps: int = STEPS
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The local minima next to starts f (k, 3) and l (3,), for each sign of det Q: Q, f, l and cost."""
        sign, f = np.repeat(signs, len(f))[:, None, None], np.tile(f, (len(signs), 1))
        lever = np.tile(lever, (len(f), 1))

        def profile() -> FloatArray:
            """(k, 3, 3): the trace of Q' times it is what Q can gain."""
            parts = (self.directions, f), (self.by_lever, lever)
            turned, by_lever = (np.einsum("ijm,km->kij", *each) for each in parts)
            return turned + by_lever + self.accelerations

        for _ in range(steps):
            Q = sign * nearest_rotation(sign * profile())
            f = unit(np.einsum("kij,ijm->km", Q, self.directions))
            lever = np.linalg.solve(
                self.lever_matrix, (self.lever_vector + np.einsum("kij,ijm->km", Q, self.by_lever)).T
            ).T
        cost = self.constant - np.einsum("kij,kij->k", Q, profile()) - lever @ self.lever_vector
        return Q, f, lever, cost + 0.5 * np.einsum("ki,ij,kj->k", lever, self.lever_matrix, lever)


def explanations(
    recovery: Recovery, excerpts: Sequence[Segment], down_K: FloatArray, within: float
) -> tuple[Explanation, tuple[Explanation, ...]] | None:
    """The answer as an explanation, and the others that fit nearly as well or better."""
    what = seen(recovery, excerpts)
    arm = recovery.calibration
    if what is None or arm is None or arm.forearm_direction is None:
        return None
    gravity = np.zeros((3, 3))
    if down_K.any() and np.isfinite(recovery.gravity_direction).all():
        gravity = np.outer(unit(down_K), recovery.gravity_direction) / DOWN_SIGMA_RAD**2
    along = arm.forearm_direction[None]
    likelihood = Likelihood(what, (np.eye(3), along[0], what.lever_A), gravity)
    answer = likelihood.lowest(along, what.lever_A, (1.0,))
    found = likelihood.lowest(np.concatenate([along, -along, sphere(STARTS)]), what.lever_A)
    best = int(np.argmin(found[3]))
    (Q, f, lever), k = (answer[:3], 0) if answer[3][0] <= found[3][best] else (found[:3], best)
    likelihood = Likelihood(what, (Q[k], f[k], lever[k]), gravity)
    own = likelihood.lowest(along, what.lever_A, (1.0,))
    Q, f, _, cost = likelihood.lowest(found[1], what.lever_A)
    cost = cost - own[3][0]
    others: list[Explanation] = []
    own_one = Explanation(own[0][0], own[1][0], 0.0)
    for k in np.argsort(cost, kind="stable").tolist():
        one = Explanation(Q[k], f[k], float(cost[k]))
        if one.cost > within:
            break
        same_kind = [each for each in others if each.is_mirrored == one.is_mirrored]
        is_own = not one.is_mirrored and one.apart_rad(own_one) < OWN_RAD
        if not is_own and all(one.apart_rad(each) > SAME_RAD for each in same_kind):
            left = what.along_K - (what.R_K_A @ one.along_A) @ one.Q_K.T
            others.append(replace(one, direction_rad=float(np.sqrt(_mean_square(left, 0.0)))))
    return own_one, tuple(others)


def effective_count(residual: FloatArray) -> float:
    """How many of some residuals (n, k), in their order, are independent of each other."""
    count, residual = len(residual), residual - residual.mean(axis=0)
    spectrum = np.fft.rfft(residual, 2 * count, axis=0)
    correlation = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=1))[:count]
    if not correlation[0] > 0.0:
        return float(count)
    correlation = correlation / correlation[0]
    ends = np.flatnonzero(correlation <= 0.05)
    correlation = correlation[1 : ends[0] if len(ends) else count]
    return float(count / (1.0 + 2.0 * correlation.sum()))


def _mean_square(residual: FloatArray, least: float) -> float:
    return max(float((residual**2).sum() / len(residual)), least**2)
