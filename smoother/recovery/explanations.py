"""Other explanations of what was seen: where they move the arm elsewhere in a gap, the gap is not trusted.

An explanation is an orthogonal matrix Q and a direction f of the forearm in the sensor: in every frame the
forearm points along `Q R_K_A f`, and a joint accelerates by Q times what the IMU says. `R_K_A` is the
answer's own attitude: the answer itself is Q = 1, and an inertial attitude's drift is gone. Where det Q = 1
the sensor is mounted otherwise; where det Q = -1 the skeleton is mirrored. Motion in one plane allows both.

Where two explanations fit the visible motion about equally well, and the hidden motion differs between them,
nothing in the recording decides between them. Both likelihoods need only second moments of what was seen, so
all directions f are tried at once, in some milliseconds; none is solved in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..linalg import nearest, sphere, unit, upright
from ..measurements.alignment import acceleration_pairs
from ..measurements.inertial import InertialAttitude
from ..measurements.segment import Segment
from ..recording import JOINTS
from ..result import Recovery
from ..rotation import Rotation

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


@dataclass(frozen=True)
class Likelihood:
    """The cost of any explanation, from second moments of what was seen."""

    directions: FloatArray  # (3, 3, 3): mean of d_i R_jk, times its weight
    accelerations: FloatArray  # (3, 3): mean of a_i b_j, times its weight
    by_lever: FloatArray  # (3, 3, 3): mean of a_i T_jk, times its weight
    lever_matrix: FloatArray  # (3, 3): of the quadratic form in l that does not depend on Q
    lever_vector: FloatArray  # (3,): its linear part
    gravity: FloatArray  # (3, 3): outer product of the frame's down and the answer's, times its weight
    constant: float  # What depends on neither

    @classmethod
    def of(
        cls, what: Seen, own: tuple[FloatArray, FloatArray, FloatArray], gravity: FloatArray
    ) -> Likelihood:
        """With the scatter that an explanation (Q, f, l) leaves."""
        Q, f, lever = own
        direction = what.along_K - (what.R_K_A @ f) @ Q.T
        weight_d = 2.0 * effective_count(direction) / _mean_square(direction, LEAST_RAD * np.sqrt(2.0))
        by_camera, count_a = what.acc_K, len(what.acc_K)
        weight_a = 0.0
        if count_a:
            left = by_camera - (what.imu_K + what.turn_K @ lever) @ Q.T
            weight_a = 3.0 * effective_count(left) / _mean_square(left, LEAST_ACCELERATION * np.sqrt(3.0))
        each_a = weight_a / max(count_a, 1)
        lever_weight = np.eye(3) / LEVER_SIGMA_M**2
        return cls(
            weight_d * _mean_outer(what.along_K, what.R_K_A),
            each_a * by_camera.T @ what.imu_K,
            each_a * np.einsum("ni,njk->ijk", by_camera, what.turn_K),
            each_a * np.einsum("nji,njk->ik", what.turn_K, what.turn_K) + lever_weight,
            lever_weight @ what.lever_A - each_a * np.einsum("nji,nj->i", what.turn_K, what.imu_K),
            gravity,
            weight_d
            + 0.5 * each_a * float((by_camera**2).sum() + (what.imu_K**2).sum())
            + 0.5 * float(what.lever_A @ lever_weight @ what.lever_A)
            + float(np.linalg.norm(gravity)),
        )

    def lowest(
        self, f: FloatArray, lever: FloatArray, sign: float, steps: int = STEPS
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The local minima next to starts f (k, 3) and l (3,) with det Q = sign: Q, f, l and the cost."""
        lever = np.tile(lever, (len(f), 1))
        for _ in range(steps):
            Q = _nearest_orthogonal(self._profile(f, lever), sign)
            f = unit(np.einsum("kij,ijm->km", Q, self.directions))
            lever = np.linalg.solve(
                self.lever_matrix, (self.lever_vector + np.einsum("kij,ijm->km", Q, self.by_lever)).T
            ).T
        cost = self.constant - np.einsum("kij,kij->k", Q, self._profile(f, lever))
        cost += 0.5 * np.einsum("ki,ij,kj->k", lever, self.lever_matrix, lever) - lever @ self.lever_vector
        return Q, f, lever, cost

    def _profile(self, f: FloatArray, lever: FloatArray) -> FloatArray:
        """(k, 3, 3): the trace of Q' times it is what Q can gain."""
        turned = np.einsum("ijm,km->kij", self.directions, f) + np.einsum("ijm,km->kij", self.by_lever, lever)
        return turned + self.accelerations + self.gravity


def explanations(
    recovery: Recovery,
    excerpts: Sequence[Segment],
    down_K: FloatArray,
    within: float,  # down_K (3,)
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
    likelihood = Likelihood.of(what, (np.eye(3), along[0], what.lever_A), gravity)
    answer = likelihood.lowest(along, what.lever_A, 1.0)
    found = _searched(likelihood, np.concatenate([along, -along, sphere(STARTS)]), what)
    best = int(np.argmin(found[3]))
    scale = answer if answer[3][0] <= found[3][best] else tuple(each[best : best + 1] for each in found)
    likelihood = Likelihood.of(what, (scale[0][0], scale[1][0], scale[2][0]), gravity)
    own = likelihood.lowest(along, what.lever_A, 1.0)
    Q, f, _, cost = _searched(likelihood, found[1], what)
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


def _searched(
    likelihood: Likelihood, starts: FloatArray, what: Seen
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The local minima next to the starts, of both kinds."""
    kinds = [likelihood.lowest(starts, what.lever_A, sign) for sign in (1.0, -1.0)]
    Q, f, lever, cost = (np.concatenate(columns) for columns in zip(*kinds, strict=True))
    return Q, f, lever, cost


def _nearest_orthogonal(matrix: FloatArray, sign: float) -> FloatArray:
    """Orthogonal matrices (k, 3, 3) of that determinant, nearest to some: the largest trace of Q' M."""
    U, _, Vt = np.linalg.svd(matrix)
    U[:, :, 2] *= (sign * np.sign(np.linalg.det(U @ Vt)))[:, None]
    return np.asarray(U @ Vt)


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


def _mean_outer(along: FloatArray, R: FloatArray) -> FloatArray:
    """(3, 3, 3): mean of d_i R_jk."""
    return np.asarray((along.T @ R.reshape(len(R), 9) / len(R)).reshape(3, 3, 3))
