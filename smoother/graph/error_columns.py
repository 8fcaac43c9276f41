"""How a window's data follow errors that are constant over a recording, and the window's evidence on them.

The errors are no variables of the graph: they enter its linearised equations as further columns, to be told
by all windows together (`evidence`), or to be considered in the covariance (Schmidt, Application of
state-space methods to navigation problems, 1966).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, G, S

from ..array_types import FloatArray, IntArray
from ..body import FOREARM
from ..linalg import skew
from ..measurements.outliers import noise_key
from ..measurements.rays import NEAREST_M
from ..recording import JOINTS
from ..window.problem import JointMeasurements, States, Window
from ..window.shared import JOINT_ERRORS, LENS, SIZE, STRAP_ERRORS, ErrorEvidence
from .build import FactorGroup, ray_roots, stacked_measurements
from .factors import IMU_ROWS, POINT_ROWS
from .linear_system import Jacobian, LinearSystem
from .shared_prior import shared_jacobian, shared_keys
from .variables import keys_of


def constant_error_columns(
    jacobian: Jacobian, window: Window, groups: Sequence[FactorGroup], biases: IntArray, R: FloatArray
) -> FloatArray:  # (r, SIZE)
    """Columns of the whitened Jacobian for the constant errors (see `window.shared`)."""
    (own,) = (group for group in groups if group.kind == "imu" and group.of == FOREARM.name)
    count, columns = len(own.factors), jacobian.columns
    all_biases = slice(columns[B(0)].start, columns[B(int(biases[-1]))].stop)
    imu = jacobian.block(own.rows, all_biases)
    of_bias = imu.reshape(count, IMU_ROWS, -1, 6)[np.arange(count), :, biases]
    # M f is a bias that follows the specific force, the same for the rate
    force, rate = _means(window)
    camera = list(camera_rows(jacobian, window, groups))
    every = np.zeros((max([own.rows.stop, *(each.rows.stop for each in camera)]), SIZE))
    every[own.rows] = np.concatenate(
        [
            np.einsum("nir,nc->nirc", of_bias[:, :, :3], force).reshape(count, IMU_ROWS, 9),
            np.einsum("nir,nc->nirc", of_bias[:, :, 3:], rate).reshape(count, IMU_ROWS, 9),
            np.zeros((count, IMU_ROWS, SIZE - 18)),
        ],
        axis=2,
    ).reshape(-1, SIZE)
    for factors in camera:
        # an error moves the joint along an axis of {K}: a whitened unit matrix, whose weight any row has;
        # that of a strap which represents the IMU along an axis of {A}
        block = np.zeros((len(factors.nodes), POINT_ROWS, SIZE))
        error = JOINT_ERRORS.start + 3 * JOINTS.index(factors.joint)
        block[:, :, error : error + 3] = R[factors.nodes] if is_place(factors.joint, window) else np.eye(3)
        if factors.joint in window.priors.layout.joints:
            block[:, :, STRAP_ERRORS] = _strap(window, factors.joint, R[factors.nodes])
        if with_lens(window):
            block[:, :, LENS] = _lens(window, factors)
        every[factors.rows] = factors.whitened(block)
    return every


def with_lens(window: Window) -> bool:
    """Whether the errors of a lens take the rows of the strap's place."""
    return window.lone_rays and all(each.joint != "strap" for each in window.joint_measurements)


def _lens(window: Window, factors: CameraRows) -> FloatArray:
    """How a joint's points (m, 3, 3) m follow the errors of the lens that sees them (`LENS`)."""
    if factors.joint == "shoulder":
        assert window.shoulder is not None
        point = window.shoulder.position[np.isfinite(window.shoulder.position[:, 0])]
    else:
        (measured,) = (each for each in window.joint_measurements if each.key == factors.key)
        _, point, _ = stacked_measurements(measured, window.noise.cauchy)
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


@dataclass(frozen=True)
class CameraRows:
    """The rows of a joint's camera factors in the whitened Jacobian."""

    joint: str
    nodes: IntArray  # int (m,): the node of each factor
    rows: slice  # Three a factor, in {K}
    weight: FloatArray  # (3 m,) 1/m: how a shift of the joint counts in each
    camera: int = 0  # The camera whose samples they are
    roots: FloatArray | None = None  # (m, 3, 3) 1/m: of a camera without depth

    def whitened(self, shift: FloatArray) -> FloatArray:
        """Rows (3 m, q) of the whitened Jacobian for quantities that shift the joint by (m, 3, q)."""
        if self.roots is None:
            return np.asarray(self.weight[:, None] * shift.reshape(-1, shift.shape[2]))
        return np.asarray((self.roots @ shift).reshape(-1, shift.shape[2]))

    @property
    def key(self) -> str:
        """As that of the `JointMeasurements`."""
        return noise_key(self.joint, self.camera)


def camera_rows(jacobian: Jacobian, window: Window, groups: Sequence[FactorGroup]) -> Iterator[CameraRows]:
    """Where each joint's camera factors are in a window's Jacobian, in their order."""
    for group in groups:
        if group.kind == "camera":
            weight = _weight(jacobian, group.rows, group.of, window)
            roots = _roots(weight, group, window)
            yield CameraRows(group.of, group.nodes, group.rows, weight, group.camera, roots)


def _roots(weight: FloatArray, group: FactorGroup, window: Window) -> FloatArray | None:
    """Square roots of information on rays, each less where its loss is: the weights of its rows show it."""
    if group.of == "shoulder":
        shoulder = window.shoulder
        if shoulder is None or shoulder.root_information is None:
            return None
        roots = shoulder.root_information[np.isfinite(shoulder.position[:, 0])]
    else:
        key = noise_key(group.of, group.camera)
        measured = next(each for each in window.joint_measurements if each.key == key)
        if measured.origin_m is None:
            return None
        nodes, _, sigmas = stacked_measurements(measured, window.noise.cauchy)
        found = ray_roots(measured, nodes, sigmas)
        if found is None:
            return None
        roots = found
    share = np.linalg.norm(weight.reshape(-1, 3), axis=1) / np.linalg.norm(roots, axis=(1, 2))
    return np.asarray(share[:, None, None] * roots)


def _means(window: Window) -> tuple[FloatArray, FloatArray]:
    """Mean specific force and rate of each interval, (n - 1, 3) each."""
    increments = window.forearm.increments
    first, steps = increments.first[:-1], np.diff(increments.first)[:, None]
    force = np.add.reduceat(increments.acc.mean(axis=1), first) / steps
    return force, np.add.reduceat(increments.gyro, first) / steps


def _strap(window: Window, joint: str, R: FloatArray) -> FloatArray:
    """How a joint (m, 3) in {K} follows the strap's turning with posture, (m, 3, 9)."""
    layout, mean = window.priors.layout, window.priors.shared.mean
    down_A = np.einsum("nji,j->ni", R, layout.down(mean))
    turned = -R @ skew(mean[layout.lever(joint)])
    return np.asarray((turned[:, :, :, None] * down_A[:, None, None, :]).reshape(len(R), 3, 9))


def _weight(jacobian: Jacobian, rows: slice, joint: str, window: Window) -> FloatArray:
    """Whitening of a joint's rows: the length of each row's derivative by position."""
    row, column, value = jacobian.entries(rows)
    columns = jacobian.columns
    if joint == "shoulder":
        knots = columns[S(0)].start, columns[S(len(window.shoulder.node) - 1)].stop  # type: ignore[union-attr]
        mine = (column >= knots[0]) & (column < knots[1])
    else:
        segment = window.priors.layout.segment_of(joint)
        first = columns[keys_of(segment).pose + window.runs(segment)[0].first].start
        mine = (column >= first) & ((column - first) % 6 >= 3)
    return np.sqrt(np.bincount(row[mine], value[mine] ** 2, minlength=rows.stop - rows.start))


def evidence(
    system: LinearSystem, values: gtsam.Values, mean: FloatArray, window: Window, biases: IntArray
) -> ErrorEvidence:
    """A window's evidence on the shared constants and the constant errors."""
    layout, keys = window.priors.layout, shared_keys(window, biases)
    jacobian = shared_jacobian(layout, values.atUnit3(G(0)))[6:, 6:]
    back = np.linalg.inv(jacobian)
    prior = np.linalg.inv(window.priors.shared.covariance[6:, 6:])
    constants = system.border_rows(keys[1:])
    errors = np.arange(system.extras.start, system.extras.start + SIZE)  # the first of them
    kept = np.concatenate([constants, errors])
    others = np.setdiff1d(np.arange(system.extras.start), constants)
    information, vector = system.information, system.vector
    across = np.linalg.solve(
        information[np.ix_(others, others)],
        np.column_stack([information[np.ix_(others, kept)], vector[others]]),
    )
    reduced = information[np.ix_(kept, kept)] - information[np.ix_(kept, others)] @ across[:, :-1]
    information_vector = vector[kept] - information[np.ix_(kept, others)] @ across[:, -1]
    turn = np.eye(len(kept))
    turn[: len(constants), : len(constants)] = back
    reduced, information_vector = turn.T @ reduced @ turn, turn.T @ information_vector
    rows = slice(0, len(constants))
    reduced[rows, rows] -= prior
    information_vector[rows] -= prior @ (window.priors.shared.mean[6:] - mean[6:])
    return ErrorEvidence(reduced, information_vector + reduced[:, rows] @ mean[6:])


def offset_column(
    jacobian: Jacobian, window: Window, groups: Sequence[FactorGroup], states: Mapping[str, States]
) -> FloatArray:  # (r, 1) 1/s
    """Column of the whitened Jacobian for a clock offset of the window's own."""
    by_key = {measured.key: measured for measured in window.joint_measurements}
    column = np.zeros((0, 1))
    for factors in camera_rows(jacobian, window, groups):
        if factors.key in by_key:
            measured = by_key[factors.key]
            mean, _ = _velocity_at_nodes(measured, states[measured.segment])
            rows = np.zeros((factors.rows.stop, 1))
            rows[: len(column)] = column
            rows[factors.rows] = factors.whitened(mean[:, :, None])
            column = rows
    return column


def stamp_columns(
    jacobian: Jacobian,
    window: Window,
    groups: Sequence[FactorGroup],
    states: Mapping[str, States],
    knots: FloatArray,  # (m,) s
) -> FloatArray:  # (r, m) 1/s
    """Columns of the whitened Jacobian for errors of the frames' times, linear between knots."""
    column = offset_column(jacobian, window, groups, states)
    columns = np.zeros((len(column), len(knots)))
    for factors in camera_rows(jacobian, window, groups):
        if factors.rows.stop <= len(column):
            apart = np.abs(window.t[factors.nodes][:, None] - knots) / (knots[1] - knots[0])
            share = np.maximum(1.0 - apart, 0.0)
            columns[factors.rows] = column[factors.rows] * np.repeat(share, POINT_ROWS, axis=0)
    return columns


def offset_information(
    system: LinearSystem, column: int, window: Window, states: Mapping[str, States]
) -> float:
    """Information on one clock offset for the whole window, all variables eliminated."""
    scatter = sum(
        _velocity_at_nodes(measured, states[measured.segment])[1] for measured in window.joint_measurements
    )
    return scatter + system.extra_information(column)


def _velocity_at_nodes(measured: JointMeasurements, states: States) -> tuple[FloatArray, float]:
    """A joint's mean velocity (m, 3) m/s at each of its camera factors, in their order."""
    node = np.unique(measured.node)
    velocity, rays = states.v[measured.node] + measured.velocity, measured.rays
    group = np.searchsorted(node, measured.node)
    total = np.stack([np.bincount(group, velocity[:, axis]) for axis in range(3)], axis=1)
    mean = total / np.bincount(group)[:, None]
    apart = velocity - mean[group]
    if rays is not None:
        apart = apart - np.sum(apart * rays, axis=1, keepdims=True) * rays
    return mean, float(np.sum(apart**2 / measured.sigma_m[:, None] ** 2))
