"""A window's problem written out again from its definitions, in numpy, for scipy to solve.

Slow (dense numeric Jacobians) and without any of GTSAM: residuals are those of preintegration (Forster
et al., TRO 2017), of points on a rigid body, and of Gaussian priors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.units import GRAVITY
from smoother.window.problem import States, Window

#: Position's own integration noise, m^2/s (the one number that the graph does not get from a window).
INTEGRATION = 1e-6


def cross(w: FloatArray) -> FloatArray:
    x, y, z = w
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp(w: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_rotvec(w).as_matrix())


def log(R: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def times(A: FloatArray, v: FloatArray) -> FloatArray:
    """A_i v_i for stacks."""
    return np.asarray(np.einsum("nij,nj->ni", A, v))


def whitener(covariance: FloatArray) -> FloatArray:
    """W with W' W = C^-1."""
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).T)


@dataclass(frozen=True)
class Unknowns:
    """A point of the search space; only windows with a single bias."""

    R: FloatArray
    p: FloatArray
    v: FloatArray
    shared: FloatArray
    shoulder: FloatArray

    @property
    def size(self) -> int:
        return 9 * len(self.p) + len(self.shared) + self.shoulder.size

    def moved(self, x: FloatArray) -> Unknowns:
        """Rotation in the body's axes, all else added."""
        n, m = len(self.p), len(self.shared)
        pose, shared, shoulder = x[: 9 * n].reshape(n, 9), x[9 * n : 9 * n + m], x[9 * n + m :]
        return Unknowns(
            self.R @ exp(pose[:, :3]),
            self.p + pose[:, 3:6],
            self.v + pose[:, 6:],
            self.shared + shared,
            self.shoulder + shoulder.reshape(-1, 3),
        )


@dataclass(frozen=True)
class Answer:
    """States at the nodes, pose covariance (position, rotation) and velocity covariance in {K}, and the
    shared vector with its covariance."""

    states: States
    pose_covariance: FloatArray
    velocity_covariance: FloatArray
    shared: FloatArray
    shared_covariance: FloatArray
    cost: float


class SlowWindow:
    """Residuals of a window, each divided by its standard deviation."""

    def __init__(self, window: Window) -> None:
        self.window = window
        self.dt = np.diff(window.t)
        self.samples = self._samples()
        self.inertial = np.array([self._interval_whitener(i) for i in range(len(self.dt))])
        self.prior = whitener(window.priors.shared.covariance)
        self.attitude = whitener(window.forearm.attitude_covariance)
        self.R0 = window.forearm.attitude

    def start(self, seed: int) -> Unknowns:
        """The window's initial values, shaken by a centimetre and two degrees."""
        rng = np.random.default_rng(seed)
        w = self.window
        knots = np.zeros((0, 3)) if w.shoulder is None else w.shoulder.start
        at = Unknowns(w.forearm.start.R, w.forearm.start.p, w.forearm.start.v, w.priors.shared.mean, knots)
        x = np.zeros(at.size)
        x[: 9 * len(w.t)] = (rng.normal(size=(len(w.t), 9)) * np.repeat([0.035, 0.01, 0.05], 3)).ravel()
        return at.moved(x)

    def _samples(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Sample after sample of all intervals at once, less the known bias: (n - 1, 3) twice, (n - 1, 1).

        An interval with fewer samples than the longest gets samples of no length.
        """
        increments = self.window.forearm.increments
        count = np.diff(increments.first)
        samples = []
        for k in range(int(count.max())):
            row = np.minimum(increments.first[:-1] + k, increments.first[1:] - 1)
            h = np.where(k < count, increments.h[row], 0.0)[:, None]
            samples += [(increments.acc[row, half], increments.gyro[row], h) for half in range(2)]
        return samples

    def _increments(self, bias: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(R, p, v) of every interval: the samples integrated once more for every bias."""
        n = len(self.dt)
        R, p, v = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.zeros((n, 3))
        for acc, gyro, h in self.samples:
            a = times(R, acc - bias[:3])
            p, v, R = p + v * h + 0.5 * a * h**2, v + a * h, R @ exp((gyro - bias[3:]) * h)
        return R, p, v

    def _interval_whitener(self, i: int) -> FloatArray:
        """White noise on every sample, propagated to (rotation, position, velocity)."""
        noise, C, R = self.window.noise, np.zeros((9, 9)), np.eye(3)
        for accs, gyros, hs in self.samples:
            acc, gyro, h = accs[i], gyros[i], float(hs[i, 0])
            if h == 0.0:
                continue
            F = np.eye(9)
            F[:3, :3] = exp(gyro * h).T
            F[3:6, :3], F[6:, :3] = -0.5 * R @ cross(acc) * h**2, -R @ cross(acc) * h
            F[3:6, 6:] = np.eye(3) * h
            by_acc = np.vstack([np.zeros((3, 3)), 0.5 * R * h**2, R * h])
            by_gyro = np.vstack([np.eye(3) * h, np.zeros((6, 3))])
            C = F @ C @ F.T
            C += by_acc @ by_acc.T * noise.accelerometer_density**2 / h
            C += by_gyro @ by_gyro.T * noise.gyroscope_density**2 / h
            C[3:6, 3:6] += np.eye(3) * INTEGRATION * h
            R = R @ exp(gyro * h)
        return whitener(C)

    def residuals(self, x: Unknowns) -> FloatArray:
        w, layout = self.window, self.window.priors.layout
        g = layout.down(x.shared) * GRAVITY
        R, p, v = self._increments(x.shared[layout.bias] - w.forearm.increments.bias)
        back, dt = np.swapaxes(x.R[:-1], 1, 2), self.dt[:, None]
        error = np.hstack(
            [
                log(np.swapaxes(R, 1, 2) @ back @ x.R[1:]),
                times(back, x.p[1:] - x.p[:-1] - x.v[:-1] * dt - 0.5 * g * dt**2) - p,
                times(back, x.v[1:] - x.v[:-1] - g * dt) - v,
            ]
        )
        out = [times(self.inertial, error).ravel()]
        for measured in w.joint_measurements:
            lever = x.shared[layout.lever(measured.joint)] if measured.joint in layout.joints else np.zeros(3)
            at_node = x.p[measured.node] + x.R[measured.node] @ lever
            out.append(((at_node - measured.position) / measured.sigma_m[:, None]).ravel())
        out.append(self.prior @ (x.shared - w.priors.shared.mean))
        out.append(self.attitude @ self.R0 @ log(self.R0.T @ x.R[w.forearm.attitude_node]))
        in_gap = np.isfinite(w.velocity_change)
        out.append((np.diff(x.v, axis=0)[in_gap] / w.velocity_change[in_gap, None]).ravel())
        return np.concatenate(out + self._shoulder(x))

    def _shoulder(self, x: Unknowns) -> list[FloatArray]:
        w, layout = self.window, self.window.priors.layout
        if w.shoulder is None:
            return []
        node, visible = w.shoulder.node, np.isfinite(w.shoulder.position[:, 0])
        measured = (x.shoulder - w.shoulder.position)[visible] / w.shoulder.sigma_m[visible, None]
        walk = np.diff(x.shoulder, axis=0) / (w.noise.shoulder_walk * np.sqrt(np.diff(w.t[node])))[:, None]
        out = [measured.ravel(), walk.ravel()]
        if layout.has_upper_arm:
            elbow = x.p[node] + x.R[node] @ w.priors.shared.mean[layout.lever("elbow")]
            length = np.linalg.norm(x.shoulder - elbow, axis=1)
            out.append((length - x.shared[layout.upper_arm]) / w.noise.upper_arm_sigma_m)
        return out

    def solve(self, seed: int = 0) -> Answer:
        """Least squares from a shaken start; covariance by (J'J)^-1 at the answer."""
        at = self.start(seed)
        for _ in range(2):  # the second time around the answer, so that rotations are small
            fit = least_squares(
                lambda x, at=at: self.residuals(at.moved(x)),
                np.zeros(at.size),
                jac=lambda x, at=at: self._slopes(at, x),
                method="lm",
                xtol=1e-7,
                ftol=1e-8,
                gtol=1e-8,
            )
            at = at.moved(fit.x)
        J = self._jacobian(at)
        C: FloatArray = np.asarray(np.linalg.inv(J.T @ J), dtype=np.float64)
        n, m = len(at.p), len(at.shared)
        pose, velocity = np.zeros((n, 6, 6)), np.zeros((n, 3, 3))
        for i in range(n):
            block = C[9 * i : 9 * i + 9, 9 * i : 9 * i + 9]
            turn = np.zeros((6, 9))
            turn[:3, 3:6], turn[3:, :3] = np.eye(3), at.R[i]
            pose[i], velocity[i] = turn @ block @ turn.T, block[6:, 6:]
        return Answer(
            States(at.R, at.p, at.v),
            pose,
            velocity,
            at.shared,
            C[9 * n : 9 * n + m, 9 * n : 9 * n + m],
            float(0.5 * self.residuals(at) @ self.residuals(at)),
        )

    def _slopes(self, at: Unknowns, x: FloatArray, step: float = 1e-6) -> FloatArray:
        """Forward differences: good enough to find the way."""
        here = self.residuals(at.moved(x))
        moves = np.eye(at.size) * step
        return np.stack([(self.residuals(at.moved(x + move)) - here) / step for move in moves], axis=1)

    def _jacobian(self, at: Unknowns, step: float = 1e-6) -> FloatArray:
        """Central differences at a point: good to 1e-8, for the covariance."""
        columns = []
        for move in np.eye(at.size) * step:
            difference = self.residuals(at.moved(move)) - self.residuals(at.moved(-move))
            columns.append(difference / (2 * step))
        return np.stack(columns, axis=1)
