"""Camera from mocap: one factor graph over all poses of the panel.

Variables: the camera in the mocap frame, every marker in the mocap frame, the plane of every pose in the
camera frame, and, with several poses, a constant error of the camera's depth. Factors: a marker where mocap
has it; the marker's pixel, as a ray; the marker on the panel's plane; the plane as the depth has it, which
shifts with the depth's error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError

from .definition import Frame, kabsch
from .plane import Plane

#: A constant error of the depth before anything is known of it, m (Kinect v2: some mm).
OFFSET_SIGMA_M = 0.01
#: A marker lies on the panel's plane to this, m: the panel's own flatness about a marker.
ON_PLANE_SIGMA_M = 0.0002
#: Huber's bound in sigmas, of a vector of 2 or 3 residuals: touches ordinary noise hardly at all.
HUBER = 3.5
#: The stated noise weighs like this many residuals against those found.
PRIOR_RESIDUALS = 12.0
#: A depth error of one pose alone is believed from this many sigmas on if with it the misfit is below this.
#: One marker that is off looks like a wrong depth too, but leaves residuals.
CLEAR, EXPLAINED = 4.0, 3.0


@dataclass(frozen=True)
class PoseData:
    """What one pose of the panel gives; markers in the panel's order."""

    rays: FloatArray  # (4, 2): of the markers, undistorted
    sigmas: FloatArray  # (4,): of a ray, per axis
    plane: Plane  # From the depth
    markers_E: FloatArray  # (4, 3) m: in the mocap frame
    sigma_E_m: float  # Of a marker, per axis
    height_m: float = 0.0  # Of the markers over the plane
    name: str = ""  # In messages

    def points_K(self, offset_m: float = 0.0) -> FloatArray:
        """The markers in the camera frame, (4, 3) m: their rays on the plane raised by their height."""
        theta = self.plane.at_offset(offset_m)
        # the plane theta . p = 1, moved by the height along the normal that faces the camera
        return self.plane_points(theta / (1 - self.height_m * float(np.linalg.norm(theta))))

    def plane_points(self, theta: FloatArray) -> FloatArray:
        """Where the markers' rays meet theta . p = 1."""
        full = np.column_stack([self.rays, np.ones(4)])
        return full / (full @ theta)[:, None]


@dataclass(frozen=True)
class PanelSolution:
    """The graph's answer."""

    camera_from_mocap: Frame  # p_K = R p_E + origin
    # (6, 6): Of a small rotation about {K}'s axes at the camera's place (rad) and a shift (m)
    covariance: FloatArray
    depth_offset_m: float  # The camera's depth is this much too long; 0 and inf where it was not solved
    depth_offset_sigma_m: float  # The camera's depth is this much too long; 0 and inf where it was not solved
    offset_apart_m: float  # That error by the markers' spacing alone
    offset_apart_sigma_m: float  # That error by the markers' spacing alone
    ray_residuals: FloatArray  # (poses, 4): of a marker's ray from where the answer puts the mocap marker
    # (poses, 4) m: Distance between a marker in mocap and where the answer puts it
    marker_residuals_m: FloatArray
    # (poses, 4) m: Mocap markers' distances from the depth's plane, signed, away positive
    plane_residuals_m: FloatArray
    misfit: float  # Squared residuals over what the stated noise makes expected
    residuals: int  # Number of independent residuals


def solve(poses: list[PoseData]) -> PanelSolution:
    """Solve for camera from mocap."""
    free = _graph_solution(poses, solve_offset=True)
    clear = abs(free.depth_offset_m) > CLEAR * free.depth_offset_sigma_m and free.misfit < EXPLAINED
    answer = free if len(poses) > 1 or clear else _graph_solution(poses, solve_offset=False)
    fields = {
        "offset_apart_m": free.depth_offset_m,
        "offset_apart_sigma_m": free.depth_offset_sigma_m,
    }
    return PanelSolution(**{**vars(answer), **fields})


def _graph_solution(poses: list[PoseData], solve_offset: bool) -> PanelSolution:
    import gtsam

    graph, start = _build(poses, solve_offset)
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-12)
    settings.setAbsoluteErrorTol(1e-12)
    try:
        values = gtsam.LevenbergMarquardtOptimizer(graph, start, settings).optimize()
        marginals = gtsam.Marginals(graph, values)
        covariance = np.array(marginals.marginalCovariance(_CAMERA))
        offset_variance = marginals.marginalCovariance(_OFFSET)[0, 0] if solve_offset else np.inf
    except RuntimeError as error:
        raise CalibrationError(
            "the panel's poses contradict each other or do not determine the transform; check that images and"
            " markers of a pose were taken at the same moment"
        ) from error
    camera_in_mocap = values.atPose3(_CAMERA)
    inverse = camera_in_mocap.inverse()
    transform = Frame(inverse.rotation().matrix(), np.array(inverse.translation()))
    offset = float(values.atVector(_OFFSET)[0]) if solve_offset else 0.0
    misfit, count = 2 * graph.error(values), 6 * len(poses)
    scale = (PRIOR_RESIDUALS + misfit) / (PRIOR_RESIDUALS + count)
    return PanelSolution(
        camera_from_mocap=transform,
        covariance=covariance * scale,
        depth_offset_m=offset,
        depth_offset_sigma_m=float(np.sqrt(offset_variance * scale)),
        offset_apart_m=0.0,
        offset_apart_sigma_m=np.inf,
        misfit=misfit / count,
        residuals=count,
        **_residuals(poses, transform, offset),
    )


_CAMERA, _OFFSET = 0, 1


def _marker(pose: int, k: int) -> int:
    return 10 + 5 * pose + k


def _plane(pose: int) -> int:
    return 10 + 5 * pose + 4


def _build(poses: list[PoseData], solve_offset: bool) -> tuple[Any, Any]:
    """The graph and its start: Kabsch on rays that meet the depth's plane."""
    import gtsam

    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    lens = gtsam.Cal3_S2(1.0, 1.0, 0.0, 0.0, 0.0)
    huber = gtsam.noiseModel.mEstimator.Huber.Create(HUBER)
    on_plane = gtsam.noiseModel.Isotropic.Sigma(1, ON_PLANE_SIGMA_M)
    seen = np.concatenate([pose.points_K() for pose in poses])
    first = kabsch(seen, np.concatenate([pose.markers_E for pose in poses]))
    start.insert(_CAMERA, gtsam.Pose3(gtsam.Rot3(first.R), first.origin))
    if solve_offset:
        start.insert(_OFFSET, np.zeros(1))
        graph.add(
            gtsam.PriorFactorVector(_OFFSET, np.zeros(1), gtsam.noiseModel.Isotropic.Sigma(1, OFFSET_SIGMA_M))
        )
    for p, pose in enumerate(poses):
        mocap = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Isotropic.Sigma(3, pose.sigma_E_m))
        start.insert(_plane(p), pose.plane.theta)
        graph.add(_depth_factor(p, pose.plane, solve_offset))
        for k in range(4):
            start.insert(_marker(p, k), pose.markers_E[k])
            graph.add(gtsam.PriorFactorPoint3(_marker(p, k), pose.markers_E[k], mocap))
            ray = gtsam.noiseModel.Isotropic.Sigma(2, float(pose.sigmas[k]))
            graph.add(
                gtsam.GenericProjectionFactorCal3_S2(
                    pose.rays[k],
                    gtsam.noiseModel.Robust.Create(huber, ray),
                    _CAMERA,
                    _marker(p, k),
                    lens,
                )
            )
            graph.add(_on_plane_factor(p, k, pose.height_m, on_plane))
    return graph, start


def _depth_factor(p: int, plane: Plane, solve_offset: bool) -> Any:
    """The pose's plane as the depth has it once its constant error is taken off."""
    import gtsam

    noise = gtsam.noiseModel.Gaussian.Covariance(plane.covariance)
    keys = [_plane(p), _OFFSET] if solve_offset else [_plane(p)]

    def error(this: Any, values: Any, jacobians: Any) -> FloatArray:
        offset = float(values.atVector(_OFFSET)[0]) if solve_offset else 0.0
        if jacobians is not None:
            jacobians[0] = np.eye(3)
            if solve_offset:
                jacobians[1] = -(plane.offset_rate + 2 * offset * plane.offset_curve)[:, None]
        return np.asarray(values.atVector(_plane(p)) - plane.at_offset(offset))

    return gtsam.CustomFactor(noise, keys, error)


def _on_plane_factor(p: int, k: int, height_m: float, noise: Any) -> Any:
    """Signed distance of a marker from the pose's plane, less its height, m."""
    import gtsam

    def error(this: Any, values: Any, jacobians: Any) -> FloatArray:
        camera, theta = values.atPose3(_CAMERA), values.atVector(_plane(p))
        d_camera, d_marker = np.zeros((3, 6), order="F"), np.zeros((3, 3), order="F")
        at = camera.transformTo(values.atPoint3(_marker(p, k)), d_camera, d_marker)
        size = float(np.linalg.norm(theta))
        away = (float(theta @ at) - 1) / size
        if jacobians is not None:
            normal = theta / size
            jacobians[0] = (normal @ d_camera)[None]
            jacobians[1] = (normal @ d_marker)[None]
            jacobians[2] = ((at - away * normal) / size)[None]
        return np.array([away + height_m])  # the normal theta points away from the camera

    return gtsam.CustomFactor(noise, [_CAMERA, _marker(p, k), _plane(p)], error)


def _residuals(poses: list[PoseData], transform: Frame, offset_m: float) -> dict[str, FloatArray]:
    rays, markers, planes = [], [], []
    for pose in poses:
        at = pose.markers_E @ transform.R.T + transform.origin
        rays.append(np.linalg.norm(at[:, :2] / at[:, 2:] - pose.rays, axis=1))
        markers.append(np.linalg.norm(at - pose.points_K(offset_m), axis=1))
        theta = pose.plane.at_offset(offset_m)
        planes.append((at @ theta - 1) / np.linalg.norm(theta) + pose.height_m)
    return {
        "ray_residuals": np.array(rays),
        "marker_residuals_m": np.array(markers),
        "plane_residuals_m": np.array(planes),
    }
