"""How a window's data follow quantities that are no variables of its graph.

They enter its linearised equations as further columns: errors that are constant over a recording, to be
estimated by all windows together (`evidence`) or considered in the covariance (Schmidt, Application of
state-space methods to navigation problems, 1966); made-up stamps and one clock offset. What a joint's samples
follow is stated as shifts of the joint in {K}; the factors' weights make columns of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import B, S

from ..array_types import FloatArray, IntArray
from ..body import FOREARM
from ..linalg import skew
from ..measurements.outliers import noise_key
from ..measurements.rays import NEAREST_M
from ..recording import JOINTS
from ..window.problem import JointMeasurements, States, Window
from ..window.shared import JOINT_ERRORS, LENS, SIZE, STRAP_ERRORS, ErrorEvidence, Gaussian
from .build import FactorGroup, ray_roots, stacked_measurements
from .factors import IMU_ROWS, POINT_ROWS
from .linear_system import LinearSystem, eliminated
from .solved import SolvedWindow
from .variables import keys_of


@dataclass(frozen=True)
class CameraRows:
    """The rows of a joint's camera factors in the whitened Jacobian."""

    joint: str
    nodes: IntArray  # int (m,): the node of each factor
    rows: slice  # Three a factor, in {K}
    weight: FloatArray  # (3 m,) 1/m: how a shift of the joint counts in each
    measured: JointMeasurements | None  # None of the shoulder
    camera: int = 0  # The camera whose samples they are
    roots: FloatArray | None = None  # (m, 3, 3) 1/m: of a camera without depth

    def whitened(self, shift: FloatArray) -> FloatArray:
        """Rows (3 m, q) of the whitened Jacobian for quantities that shift the joint by (m, 3, q)."""
        if self.roots is None:
            return np.asarray(self.weight[:, None] * shift.reshape(-1, shift.shape[2]))
        return np.asarray((self.roots @ shift).reshape(-1, shift.shape[2]))


def camera_rows(solved: SolvedWindow) -> Iterator[CameraRows]:
    """Where each joint's camera factors are in a window's Jacobian, in their order."""
    by_key = {measured.key: measured for measured in solved.window.joint_measurements}
    for group in solved.groups:
        if group.kind == "camera":
            measured = None if group.of == "shoulder" else by_key[noise_key(group.of, group.camera)]
            weight = _weight(solved, group)
            roots = _roots(weight, measured, solved.window)
            yield CameraRows(group.of, group.nodes, group.rows, weight, measured, group.camera, roots)


def _weight(solved: SolvedWindow, group: FactorGroup) -> FloatArray:
    """Whitening of a joint's rows: the length of each row's derivative by position."""
    window, columns = solved.window, solved.jacobian.columns
    row, column, value = solved.jacobian.entries(group.rows)
    if window.shoulder is not None and group.of == "shoulder":
        first, stop = columns[S(0)].start, columns[S(len(window.shoulder.node) - 1)].stop
        mine = (column >= first) & (column < stop)
    else:
        segment = window.priors.layout.segment_of(group.of)
        first = columns[keys_of(segment).pose + window.runs(segment)[0].first].start
        mine = (column >= first) & ((column - first) % 6 >= 3)
    return np.sqrt(np.bincount(row[mine], value[mine] ** 2, minlength=group.rows.stop - group.rows.start))


def _roots(weight: FloatArray, measured: JointMeasurements | None, window: Window) -> FloatArray | None:
    """Square roots of information on rays, each less where its loss is: the weights of its rows show it."""
    if measured is not None:
        if measured.origin_m is None:
            return None
        nodes, _, sigmas = stacked_measurements(measured, window.noise.cauchy)
        roots = ray_roots(measured, nodes, sigmas)
    else:
        shoulder = window.shoulder
        if shoulder is None or shoulder.root_information is None:
            return None
        roots = shoulder.root_information[np.isfinite(shoulder.position[:, 0])]
    assert roots is not None
    share = np.linalg.norm(weight.reshape(-1, 3), axis=1) / np.linalg.norm(roots, axis=(1, 2))
    return np.asarray(share[:, None, None] * roots)


def constant_error_columns(solved: SolvedWindow) -> FloatArray:  # (r, SIZE)
    """Columns of the whitened Jacobian for the constant errors (see `window.shared`)."""
    window, biases, R = solved.window, solved.biases, solved.states[FOREARM.name].R
    (own,) = (group for group in solved.groups if group.kind == "imu" and group.of == FOREARM.name)
    count, columns = len(own.factors), solved.jacobian.columns
    all_biases = slice(columns[B(0)].start, columns[B(int(biases[-1]))].stop)
    imu = solved.jacobian.block(own.rows, all_biases)
    of_bias = imu.reshape(count, IMU_ROWS, -1, 6)[np.arange(count), :, biases]
    # M f is a bias that follows the mean specific force of an interval, the same for the rate
    increments = window.forearm.increments
    first, steps = increments.first[:-1], np.diff(increments.first)[:, None]
    force = np.add.reduceat(increments.acc.mean(axis=1), first) / steps
    rate = np.add.reduceat(increments.gyro, first) / steps
    every = np.zeros((len(solved.jacobian.rhs), SIZE))
    of_imu = every[own.rows].reshape(count, IMU_ROWS, SIZE)
    of_imu[:, :, :9] = np.einsum("nir,nc->nirc", of_bias[:, :, :3], force).reshape(count, IMU_ROWS, 9)
    of_imu[:, :, 9:18] = np.einsum("nir,nc->nirc", of_bias[:, :, 3:], rate).reshape(count, IMU_ROWS, 9)
    for factors in camera_rows(solved):
        # an error moves the joint along an axis of {K}; that of a strap which represents the IMU along an
        # axis of {A}
        own_R, joint = R[factors.nodes], factors.joint
        shift = np.zeros((len(factors.nodes), POINT_ROWS, SIZE))
        error = JOINT_ERRORS.start + 3 * JOINTS.index(joint)
        shift[:, :, error : error + 3] = own_R if is_place(joint, window) else np.eye(3)
        if joint in window.priors.layout.joints:
            # the strap turns with posture
            layout, mean = window.priors.layout, window.priors.shared.mean
            down_A = np.einsum("nji,j->ni", own_R, layout.down(mean))
            turned = -own_R @ skew(mean[layout.lever(joint)])
            by_down = turned[:, :, :, None] * down_A[:, None, None, :]
            shift[:, :, STRAP_ERRORS] = by_down.reshape(len(own_R), 3, 9)
        if with_lens(window):
            shift[:, :, LENS] = _lens(window, factors)
        every[factors.rows] = factors.whitened(shift)
    return every


def with_lens(window: Window) -> bool:
    """Whether the errors of a lens take the rows of the strap's place."""
    return window.lone_rays and all(each.joint != "strap" for each in window.joint_measurements)


def _lens(window: Window, factors: CameraRows) -> FloatArray:
    """How a joint's points (m, 3, 3) m follow the errors of the lens that sees them (`LENS`)."""
    if factors.measured is None:
        assert window.shoulder is not None
        point = window.shoulder.position[np.isfinite(window.shoulder.position[:, 0])]
    else:
        _, point, _ = stacked_measurements(factors.measured, window.noise.cauchy)
    # of the joint, not of the keypoint: noise on both sides of the equation would draw the lens
    assert factors.roots is not None
    ray = np.linalg.eigh(factors.roots)[1][:, :, 0]
    point = np.sum(point * ray, axis=1, keepdims=True) * ray
    off = point * [1.0, 1.0, 0.0]
    squared = np.sum((off / np.maximum(point[:, 2:], NEAREST_M)) ** 2, axis=1, keepdims=True)
    return np.stack([off, squared * off, np.zeros_like(off)], axis=2)


def is_place(joint: str, window: Window) -> bool:
    """Whether a tracked joint is the IMU's own place, with no lever arm to solve."""
    return joint == "strap" and joint not in window.priors.layout.joints


def stamp_columns(solved: SolvedWindow, knots: FloatArray | None = None) -> FloatArray:  # (r, m) 1/s
    """Columns for errors of the frames' times, linear between knots (m,) s; without knots for one offset."""
    columns = np.zeros((len(solved.jacobian.rhs), 1 if knots is None else len(knots)))
    for factors in camera_rows(solved):
        if factors.measured is None:
            continue
        late = velocity_at_nodes(factors.measured, solved.states[factors.measured.segment])[0][:, :, None]
        if knots is not None:
            apart = np.abs(solved.window.t[factors.nodes][:, None] - knots) / (knots[1] - knots[0])
            late = late * np.maximum(1.0 - apart, 0.0)[:, None, :]
        columns[factors.rows] = factors.whitened(late)
    return columns


def offset_information(solved: SolvedWindow, system: LinearSystem, column: int) -> float:
    """Information on one clock offset for the whole window, all variables eliminated."""
    scatter = sum(
        velocity_at_nodes(measured, solved.states[measured.segment])[1]
        for measured in solved.window.joint_measurements
    )
    return scatter + system.extra_information(column)


def velocity_at_nodes(measured: JointMeasurements, states: States) -> tuple[FloatArray, float]:
    """A joint's mean velocity (m, 3) m/s at each of its camera factors, and its scatter in 1/sigma^2."""
    node = np.unique(measured.node)
    velocity, rays = states.v[measured.node] + measured.velocity, measured.rays
    group = np.searchsorted(node, measured.node)
    total = np.stack([np.bincount(group, velocity[:, axis]) for axis in range(3)], axis=1)
    mean = total / np.bincount(group)[:, None]
    apart = velocity - mean[group]
    if rays is not None:
        apart = apart - np.sum(apart * rays, axis=1, keepdims=True) * rays
    return mean, float(np.sum(apart**2 / measured.sigma_m[:, None] ** 2))


def evidence(solved: SolvedWindow, system: LinearSystem, prior: Gaussian) -> ErrorEvidence:
    """A window's evidence on the shared constants and the constant errors, the prior on them taken off."""
    mean, border = solved.shared[6:], system.extras.start
    constants = system.border_rows(solved.shared_keys[1:])
    kept = np.concatenate([constants, np.arange(border, border + SIZE)])  # the errors are the first extras
    others = np.setdiff1d(np.arange(border), constants)
    information, vector = eliminated(system.information, system.vector, kept, others)
    turn = np.eye(len(kept))
    turn[: len(constants), : len(constants)] = np.linalg.inv(solved.shared_jacobian[6:, 6:])
    information, vector = turn.T @ information @ turn, turn.T @ vector
    rows, known = slice(0, len(constants)), np.linalg.inv(prior.covariance[6:, 6:])
    information[rows, rows] -= known
    vector[rows] -= known @ (prior.mean[6:] - mean)
    return ErrorEvidence(information, vector + information[:, rows] @ mean)
