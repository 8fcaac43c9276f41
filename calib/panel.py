"""`calibrate panel`: camera to mocap from views of the marker panel (JA II-F.1, refined).

Bright spots, which is which, regions without markers, a plane, the panel's axes as published, and one factor
graph over all poses. Its variables: the camera in the mocap frame, every marker in the mocap frame, the plane
of every pose in the camera frame, and, with several poses, a constant error of the camera's depth. Its
factors: a marker where mocap has it; the marker's pixel, as a ray; the marker on the panel's plane; the plane
as the depth has it, which shifts with the depth's error.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, permutations
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from smoother.array_types import BoolArray, FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import nearest_rotation, skew, unit

from .file import CalibrationFile, FileSection, checked, toml_document
from .images import (
    Blobs,
    Frame,
    Panel,
    Plane,
    View,
    check_size,
    find_blobs,
    fit_plane,
    on_plane,
    panel_regions,
    robust_plane,
    strip,
)
from .intrinsics import Intrinsics
from .protocol import Answer, Check, graded

#: A panel that is larger, or whose markers are nearer, was not measured in metres.
LARGEST_M, NEAREST_M = 5.0, 0.02
_Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class _PanelSection(FileSection):
    markers: Annotated[list[_Pair], Field(min_length=4, max_length=4)]
    extent: Annotated[list[_Pair], Field(min_length=2, max_length=2)]
    marker_height: float = Field(default=0.0, ge=0.0, le=0.1)

    @model_validator(mode="after")
    def _sound(self) -> Self:
        markers, extent = np.array(self.markers), np.array(self.extent)
        gaps = np.linalg.norm(markers[:, None] - markers[None], axis=2)[np.triu_indices(4, 1)]
        if gaps.max() > LARGEST_M:
            raise ValueError(f"the markers are up to {gaps.max():.0f} m apart; give them in metres")
        if gaps.min() < NEAREST_M:
            raise ValueError("two markers are less than 2 cm apart")
        if not (extent[1] > extent[0]).all():
            raise ValueError("extent must be [[xmin, ymin], [xmax, ymax]]")
        if (markers < extent[0]).any() or (markers > extent[1]).any():
            raise ValueError("a marker lies outside extent")
        spread = np.linalg.svd(markers - markers.mean(axis=0), compute_uv=False)
        if spread[1] < 0.1 * spread[0]:
            raise ValueError("the markers lie on one line; they must form an L")
        return self


def read_panel(path: str | os.PathLike[str]) -> Panel:
    """Read the table `[panel]` of a TOML file: `markers`, `extent` and, if any, `marker_height` (m)."""
    document = toml_document(Path(path), str(path))
    if not isinstance(document.get("panel"), dict):
        raise CalibrationError(f"{path} has no table [panel] with markers and extent.")
    section = checked(_PanelSection, document["panel"], f"{path}: panel")
    return Panel(np.array(section.markers), np.array(section.extent), section.marker_height)


#: Fewer points than this make no group for a principal component.
FEWEST = 20
#: Principal components are taken of not more points than this: more add nothing and cost seconds.
MOST = 20_000
#: Statistical removal of outliers: neighbours looked at, and sigmas allowed.
NEIGHBOURS, SIGMAS = 20, 2.5


def frame_of_points(
    points_K: FloatArray, along_x: BoolArray, along_y: BoolArray, about_R: FloatArray
) -> Frame | None:
    """The panel in the camera by principal components, as published (JA II-F.1)."""
    if min(along_x.sum(), along_y.sum()) < FEWEST:
        return None
    (a, axes_x), (b, axes_y), (_, axes_all) = map(principal, (points_K[along_x], points_K[along_y], points_K))
    axes = np.column_stack([axes_x[:, 0], axes_y[:, 0], axes_all[:, 2]])
    axes *= np.sign(np.sum(axes * about_R, axis=0))
    x, y = axes[:, 0], axes[:, 1]
    # the middle of the shortest link between the lines a + s x and b + t y
    s, t = np.linalg.lstsq(np.column_stack([x, -y]), b - a, rcond=None)[0]
    return Frame(nearest_rotation(axes), 0.5 * (a + s * x + b + t * y))


def frame_of_markers(markers: FloatArray, panel: Panel) -> Frame:
    """The panel from its markers in order, (4, 3) m, as published: axes along the arms, z = x cross y."""
    away = panel.markers_P - panel.markers_P[0]
    axes = np.zeros((3, 3))
    for axis in (0, 1):
        along = np.abs(away[:, axis])
        end = np.argmax(np.where(along > 2 * np.abs(away[:, 1 - axis]), along, -1.0))
        axes[:, axis] = unit((markers[end] - markers[0]) * np.sign(away[end, axis]))
    axes[:, 2] = unit(np.cross(axes[:, 0], axes[:, 1]))
    return Frame(nearest_rotation(axes), markers[0])


def fit_frame(points: FloatArray, panel: Panel) -> Frame:
    """Pose of the panel by least squares on its markers (4, 3), in order; `origin` is {P}'s."""
    return kabsch(np.column_stack([panel.markers_P, np.full(4, panel.height_m)]), points)


def kabsch(source: FloatArray, target: FloatArray) -> Frame:
    """Rotation and shift that take points (N, 3) of one frame to those of another, by least squares."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    R = nearest_rotation((target - b).T @ (source - a))
    return Frame(R, b - R @ a)


def principal(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (3,) and principal components (columns, the largest first) of points (N, 3) less outliers."""
    from smoother.runtime.packages import load_open3d

    open3d = load_open3d()
    points = points[:: -(-len(points) // MOST)]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.ascontiguousarray(points)))
    if len(points) > 2 * NEIGHBOURS:
        cloud, _ = cloud.remove_statistical_outlier(NEIGHBOURS, SIGMAS)
    mean, covariance = cloud.compute_mean_and_covariance()
    axes = np.linalg.eigh(np.asarray(covariance))[1][:, ::-1]
    return np.asarray(mean, dtype=np.float64), np.asarray(axes, dtype=np.float64)


#: Distances between markers agree with the panel's this well (rms), m or as a share of its size.
FIT_M, FIT_SHARE = 0.005, 0.006
#: All distances may be this much too long or too short together: the depth's error, the focal length's.
SCALE = 0.04
#: Another reading is as good where its misfit is below this many times the best one's, and this much more, m.
AS_GOOD, MORE_M = 3.0, 0.0015
#: Steeper against the line of sight than this a panel is edge-on, degrees between normal and line of sight.
EDGE_ON_DEG = 65.0
#: Spots whose spread across is below this share of that along lie on one line.
ON_ONE_LINE = 0.1
SEE_DEPTH = "check that the camera measures depth there (dull surface, 0.5 to 4 m away, no sunlight)."
TURN_IT = "turn it towards the camera, within 40 degrees of facing it."
_PAIRS = np.array(list(combinations(range(4), 2)))
_ORDERS = np.array(list(permutations(range(4))))


class NotSeen(CalibrationError):
    """The panel was not found in a view."""

    def __init__(self, text: str, final: bool = False):
        super().__init__(text)
        self.final = final  # No other threshold of brightness would help
        self.view: View | None = None  # What was looked at
        self.blobs: Blobs | None = None


class NotIdentified(NotSeen):
    """The four markers could not be identified; a picture of what was seen helps."""


@dataclass(frozen=True)
class Reading:
    """One way to read four points as the panel's markers."""

    index: tuple[int, ...]  # (4,) which point is which marker
    misfit_m: float  # Rms of the distances' differences, but for a scale common to all
    places: FloatArray  # (4, 3) m: the points, in the panel's order


def identify_spots(blobs: Blobs, depth_m: FloatArray, rays: FloatArray, panel: Panel, name: str) -> Reading:
    """The spots that are the panel's markers."""
    if len(blobs) < 4:
        count = ("no bright spot is", "one bright spot is", "two bright spots are", "three bright spots are")
        raise NotIdentified(
            f"{name}: {count[len(blobs)]} visible in the infrared image and the panel has four markers;"
            " check that all four face the camera and nothing covers them."
        )
    sets = np.array(list(combinations(range(len(blobs)), 4)))
    thetas = _planes(blobs.pixels[sets], depth_m, rays)
    known = np.isfinite(thetas).all(axis=1)
    spread = np.linalg.svd(blobs.rays - blobs.rays.mean(axis=0), compute_uv=False)
    edge_on = NotSeen(f"{name}: the panel is seen edge-on; {TURN_IT}")
    on_one_line = bool(spread[1] < ON_ONE_LINE * spread[0])
    if not known.any():
        depth = NotSeen(f"{name}: depth is missing under the panel; {SEE_DEPTH}")
        raise edge_on if on_one_line else depth
    sets, thetas = sets[known], thetas[known]
    ray = np.concatenate([blobs.rays[sets], np.ones((*sets.shape, 1))], axis=2)
    inverse = np.einsum("skj,sj->sk", ray, thetas)
    places = ray / np.where(inverse > 0.05, inverse, np.nan)[..., None]
    readings = _readings(places, sets, panel.markers_P, SCALE)
    facing = [reading for reading in readings if _faces(reading, panel)]
    if not facing and readings:
        raise NotSeen(
            f"{name}: the markers are the mirror image of the panel's definition; give its markers as seen"
            " from the side of the markers, x along the longer arm and x cross y towards the camera.",
            final=True,
        )
    if not facing:
        four, is_steep = places[0], False
        if len(blobs) == 4 and np.isfinite(four).all():
            normal, ray = np.linalg.svd(four - four.mean(axis=0))[2][2], unit(four.mean(axis=0))
            is_steep = abs(float(normal @ ray)) < np.cos(np.radians(EDGE_ON_DEG - 10))
        if on_one_line or is_steep:
            raise edge_on
        raise NotIdentified(
            f"{name}: of {len(blobs)} bright spots no four have the distances of the panel's definition; see"
            " that all four markers are visible and the panel was measured in metres; cover reflections."
        )
    return _clearly_best(
        facing,
        f"{name}: {len(blobs)} bright spots are visible and fit the panel in more than one way; cover"
        " reflections beside the four markers.",
    )


def identify_markers(markers_E: FloatArray, panel: Panel, name: str) -> Reading:  # markers_E (M, 3) m
    """The mocap markers that are the panel's."""
    if len(markers_E) < 4:
        raise NotIdentified(f"{name}: {len(markers_E)} mocap markers were given and the panel has four.")
    if len(markers_E) > 40:
        raise NotIdentified(f"{name}: {len(markers_E)} markers are too many; give only the panel's four.")
    sets = np.array(list(combinations(range(len(markers_E)), 4)))
    readings = _readings(markers_E[sets], sets, panel.markers_P, 0.02)
    if not readings:
        size = np.ptp(markers_E, axis=0).max() / panel.size_m
        unit = " (they look like millimetres; give metres)" if 200 < size < 5000 else ""
        raise NotIdentified(
            f"{name}: the mocap markers do not have the distances of the panel's definition{unit}; check"
            " that the file belongs to this panel, and measure the panel again."
        )
    return _clearly_best(
        readings,
        f"{name}: the mocap markers fit the panel in more than one way; use a panel whose arms differ in"
        " length, and give only its four markers.",
    )


def _readings(places: FloatArray, sets: FloatArray, markers_P: FloatArray, scale_off: float) -> list[Reading]:
    """All ways to read sets of four places (S, 4, 3) as the panel, the best first."""
    lengths = np.linalg.norm(places[:, _PAIRS[:, 0]] - places[:, _PAIRS[:, 1]], axis=2)  # (S, 6)
    # markers (orders, pairs): the set's point k is taken for marker order[k]
    wanted = np.linalg.norm(markers_P[_ORDERS[:, _PAIRS[:, 0]]] - markers_P[_ORDERS[:, _PAIRS[:, 1]]], axis=2)
    scale = lengths @ wanted.T / (wanted**2).sum(axis=1)  # (S, 24)
    misfit = np.sqrt(np.mean((lengths[:, None] / scale[..., None] - wanted[None]) ** 2, axis=2))
    fits = (misfit < max(FIT_M, FIT_SHARE * wanted.max())) & (np.abs(scale - 1) < scale_off)
    found = []
    for row, order in zip(*np.nonzero(fits), strict=True):
        own = np.argsort(_ORDERS[order])
        found.append(Reading(tuple(sets[row][own].tolist()), float(misfit[row, order]), places[row][own]))
    return sorted(found, key=lambda reading: reading.misfit_m)


def _clearly_best(readings: list[Reading], otherwise: str) -> Reading:
    best = readings[0]
    if len(readings) > 1 and readings[1].misfit_m < max(AS_GOOD * best.misfit_m, best.misfit_m + MORE_M):
        raise NotIdentified(otherwise, final=True)
    return best


def _faces(reading: Reading, panel: Panel) -> bool:
    """Whether x cross y of this reading points towards the camera."""
    markers, at = panel.markers_P - panel.markers_P.mean(axis=0), reading.places
    axes = np.linalg.lstsq(markers, at - at.mean(axis=0), rcond=None)[0]  # images of the panel's x and y
    return bool(np.cross(axes[0], axes[1]) @ at.mean(axis=0) < 0)


def _planes(corners: FloatArray, depth_m: FloatArray, rays: FloatArray) -> FloatArray:
    """Planes (S, 3) of the depth between four spots each (S, 4, 2); nan where there was too little of it."""
    weights = np.random.default_rng(0).dirichlet(np.ones(4), 400)
    weights = weights[weights.max(axis=1) < 0.8][:240]  # away from the markers' own holes
    thetas = np.full((len(corners), 3), np.nan)
    for row, pixels in enumerate(np.rint(weights @ corners).astype(int)):
        u, v = pixels[np.isfinite(depth_m[pixels[:, 1], pixels[:, 0]])].T
        if len(u) >= 30:
            thetas[row] = robust_plane(rays[v, u], depth_m[v, u])
    return thetas


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

    def points_K(self, offset_m: float = 0.0) -> FloatArray:
        """The markers in the camera frame, (4, 3) m: their rays on the plane raised by their height."""
        return on_plane(raised(self.plane.at_offset(offset_m), self.height_m), self.rays)


def raised(theta: FloatArray, height_m: float) -> FloatArray:
    """The plane theta . p = 1 moved by a height along the normal that faces the camera."""
    return np.asarray(theta / (1 - height_m * float(np.linalg.norm(theta))))


@dataclass(frozen=True)
class PanelSolution:
    """The graph's answer."""

    camera_from_mocap: Frame  # p_K = R p_E + origin
    # (6, 6): Of a small rotation about {K}'s axes at the camera's place (rad) and a shift (m)
    covariance: FloatArray
    depth_offset_m: float  # The camera's depth is this much too long; 0 and inf where it was not solved
    depth_offset_sigma_m: float
    ray_residuals: FloatArray  # (poses, 4): of a marker's ray from where the answer puts the mocap marker
    marker_residuals_m: FloatArray  # (poses, 4) m: between a marker in mocap and where the answer puts it
    # (poses, 4) m: Mocap markers' distances from the depth's plane, signed, away positive
    plane_residuals_m: FloatArray
    misfit: float  # Squared residuals over what the stated noise makes expected
    offset_apart_m: float = 0.0  # The depth's error by the markers' spacing alone
    offset_apart_sigma_m: float = np.inf


def solve(poses: list[PoseData]) -> PanelSolution:
    """Solve for camera from mocap."""
    free = graph_solution(poses, solve_offset=True)
    clear = abs(free.depth_offset_m) > CLEAR * free.depth_offset_sigma_m and free.misfit < EXPLAINED
    answer = free if len(poses) > 1 or clear else graph_solution(poses, solve_offset=False)
    return replace(answer, offset_apart_m=free.depth_offset_m, offset_apart_sigma_m=free.depth_offset_sigma_m)


#: Variables of the graph; those of a pose follow: its four markers and its plane.
_CAMERA, _OFFSET, _FIRST = 0, 1, 2
#: A depth error that is not solved for is held at zero to this, m.
HELD_M = 1e-7


def graph_solution(poses: list[PoseData], solve_offset: bool) -> PanelSolution:
    """The optimum of the graph of all poses, with or without the depth's error.

    It starts with Kabsch on rays that meet the depth's plane.
    """
    import gtsam

    noise = gtsam.noiseModel
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    lens, huber = gtsam.Cal3_S2(1.0, 1.0, 0.0, 0.0, 0.0), noise.mEstimator.Huber.Create(HUBER)
    seen = np.concatenate([pose.points_K() for pose in poses])
    first = kabsch(seen, np.concatenate([pose.markers_E for pose in poses]))
    start.insert(_CAMERA, gtsam.Pose3(gtsam.Rot3(first.R), first.origin))
    start.insert(_OFFSET, np.zeros(1))
    known = noise.Isotropic.Sigma(1, OFFSET_SIGMA_M if solve_offset else HELD_M)
    graph.add(gtsam.PriorFactorVector(_OFFSET, np.zeros(1), known))
    for p, pose in enumerate(poses):
        plane, markers = _FIRST + 5 * p, range(_FIRST + 5 * p + 1, _FIRST + 5 * p + 5)
        start.insert(plane, pose.plane.theta)
        spread = noise.Gaussian.Covariance(pose.plane.covariance)
        graph.add(gtsam.CustomFactor(spread, [plane, _OFFSET], partial(_off_depth, pose.plane)))
        mocap = noise.Robust.Create(huber, noise.Isotropic.Sigma(3, pose.sigma_E_m))
        for key, at, ray, sigma in zip(markers, pose.markers_E, pose.rays, pose.sigmas, strict=True):
            start.insert(key, at)
            graph.add(gtsam.PriorFactorPoint3(key, at, mocap))
            pixel = noise.Robust.Create(huber, noise.Isotropic.Sigma(2, float(sigma)))
            graph.add(gtsam.GenericProjectionFactorCal3_S2(ray, pixel, _CAMERA, key, lens))
            flat, keys = noise.Isotropic.Sigma(1, ON_PLANE_SIGMA_M), [_CAMERA, key, plane]
            graph.add(gtsam.CustomFactor(flat, keys, partial(_off_plane, pose.height_m)))
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
    inverse = values.atPose3(_CAMERA).inverse()
    transform = Frame(inverse.rotation().matrix(), np.array(inverse.translation()))
    offset = float(values.atVector(_OFFSET)[0]) if solve_offset else 0.0
    theta = np.array([pose.plane.at_offset(offset) for pose in poses])
    at = np.array([pose.markers_E for pose in poses]) @ transform.R.T + transform.origin
    away = (np.einsum("pki,pi->pk", at, theta) - 1) / np.linalg.norm(theta, axis=1)[:, None]
    rays = np.array([pose.rays for pose in poses])
    misfit, count = 2 * graph.error(values), 6 * len(poses)
    scale = (PRIOR_RESIDUALS + misfit) / (PRIOR_RESIDUALS + count)
    return PanelSolution(
        camera_from_mocap=transform,
        covariance=covariance * scale,
        depth_offset_m=offset,
        depth_offset_sigma_m=float(np.sqrt(offset_variance * scale)),
        misfit=misfit / count,
        ray_residuals=np.linalg.norm(at[..., :2] / at[..., 2:] - rays, axis=2),
        marker_residuals_m=np.linalg.norm(at - np.array([each.points_K(offset) for each in poses]), axis=2),
        plane_residuals_m=away + np.array([[pose.height_m] for pose in poses]),
    )


def _off_depth(plane: Plane, this: Any, values: Any, jacobians: Any) -> FloatArray:
    """A pose's plane from what the depth has it as once its constant error is taken off."""
    own, of_offset = this.keys()
    offset = float(values.atVector(of_offset)[0])
    if jacobians is not None:
        jacobians[0] = np.eye(3)
        jacobians[1] = -(plane.offset_rate + 2 * offset * plane.offset_curve)[:, None]
    return np.asarray(values.atVector(own) - plane.at_offset(offset))


def _off_plane(height_m: float, this: Any, values: Any, jacobians: Any) -> FloatArray:
    """Signed distance of a marker from the pose's plane, less its height, m."""
    of_camera, of_marker, of_plane = this.keys()
    theta = values.atVector(of_plane)
    d_camera, d_marker = np.zeros((3, 6), order="F"), np.zeros((3, 3), order="F")
    at = values.atPose3(of_camera).transformTo(values.atPoint3(of_marker), d_camera, d_marker)
    size = float(np.linalg.norm(theta))
    away, normal = (float(theta @ at) - 1) / size, theta / size
    if jacobians is not None:
        jacobians[0] = (normal @ d_camera)[None]
        jacobians[1] = (normal @ d_marker)[None]
        jacobians[2] = ((at - away * normal) / size)[None]
    return np.array([away + height_m])  # the normal theta points away from the camera


#: Noise of a mocap marker where nothing else is said, m per axis.
MOCAP_SIGMA_M = 0.0002
#: Less of the panel than this with depth is as good as none.
LEAST_COVERED = 0.15


@dataclass(frozen=True)
class SeenPanel:
    """The panel in one view."""

    blobs: Blobs  # All bright spots
    spots: tuple[int, ...]  # Those of the four markers, in the panel's order
    plane: Plane  # Through its depth pixels
    points_K: FloatArray  # (4, 3) m: the markers in the camera frame
    frame: Frame  # The panel's axes and {P}'s origin in the camera frame, by markers and plane
    published: Frame | None  # The same as published, by principal components; its origin is the first marker
    tilt_deg: float  # Between the panel's normal and the line of sight
    distance_m: float  # Of the markers' middle from the camera


@dataclass(frozen=True)
class PanelCalibration:
    """Camera to mocap with the data it is based on."""

    solution: PanelSolution  # The graph's answer
    published: Frame | None  # Camera from mocap as published (JA eq 4 and 5), the poses' mean
    seen: tuple[SeenPanel, ...]  # By pose, the panel in the view
    markers_E: tuple[FloatArray, ...]  # (4, 3) m: by pose, the panel's mocap markers
    labels: tuple[tuple[str, ...], ...]  # By pose, their names
    names: tuple[str, ...]  # Of the poses
    panel: Panel  # What was known beforehand
    lens: Intrinsics  # What was known beforehand


def calibrate_panel(
    views: Sequence[View],
    markers: Sequence[dict[str, FloatArray]],
    panel: Panel,
    lens: Intrinsics,
    mocap_sigma_m: float = MOCAP_SIGMA_M,
) -> PanelCalibration:
    """Find camera from mocap from views of the panel, each with the mocap markers of the same moment."""
    labels, markers_E = [], []
    for each, view in zip(markers, views, strict=True):
        reading = identify_markers(np.array(list(each.values())).reshape(-1, 3), panel, view.name)
        labels.append(tuple(list(each)[index] for index in reading.index))
        markers_E.append(reading.places)
    seen = [see_panel(view, panel, lens) for view in views]
    solution = solve(
        [
            PoseData(
                rays=found.blobs.rays[list(found.spots)],
                sigmas=found.blobs.sigmas_px[list(found.spots)] / lens.focal_px,
                plane=found.plane,
                markers_E=at,
                sigma_E_m=mocap_sigma_m,
                height_m=panel.height_m,
            )
            for found, at in zip(seen, markers_E, strict=True)
        ]
    )
    published = [
        found.published.after(frame_of_markers(at, panel))
        for found, at in zip(seen, markers_E, strict=True)
        if found.published is not None
    ]
    return PanelCalibration(
        solution=solution,
        published=mean_frame(published, np.concatenate(markers_E)) if published else None,
        seen=tuple(seen),
        markers_E=tuple(markers_E),
        labels=tuple(labels),
        names=tuple(view.name for view in views),
        panel=panel,
        lens=lens,
    )


def see_panel(view: View, panel: Panel, lens: Intrinsics) -> SeenPanel:
    """Find the panel in a view: spots, which is which, regions, plane, axes."""
    check_size(view, lens)
    blobs, reading = _spots(view, panel, lens)
    rays, frame = blobs.rays[list(reading.index)], fit_frame(reading.places, panel)
    # the markers' places are read off the depth between them; then the whole panel's depth is used
    for _ in range(2):
        regions = panel_regions(view.depth_m, lens, blobs, panel, frame)
        if regions.covered < LEAST_COVERED:
            raise NotSeen(
                f"{view.name}: depth is missing under the panel: {100 * regions.covered:.0f} % of it has one;"
                f" {SEE_DEPTH}"
            )
        plane = fit_plane(regions.pixels, regions.rays, regions.depth_m, view.name)
        points = on_plane(raised(plane.theta, panel.height_m), rays)
        frame = fit_frame(points, panel)
    middle = points.mean(axis=0)
    distance = float(np.linalg.norm(middle))
    tilt = float(np.degrees(np.arccos(np.clip(-(plane.normal @ middle) / distance, -1, 1))))
    if tilt > EDGE_ON_DEG:
        raise NotSeen(
            f"{view.name}: the panel is seen edge-on, {tilt:.0f} degrees from facing the camera; {TURN_IT}"
        )
    rays, depth, panel_P = (each[plane.inliers] for each in (regions.rays, regions.depth_m, regions.panel_P))
    along_x, along_y = (strip(panel_P, panel, axis, regions.cell_m) for axis in (0, 1))
    points_K = np.column_stack([rays, np.ones(len(rays))]) * depth[:, None]
    published = frame_of_points(points_K, along_x, along_y, frame.R)
    if published is not None:
        published = Frame(published.R, published.origin + panel.height_m * published.R[:, 2])
    return SeenPanel(blobs, reading.index, plane, points, frame, published, tilt, distance)


def _spots(view: View, panel: Panel, lens: Intrinsics) -> tuple[Blobs, Reading]:
    """Bright spots at the first threshold at which four of them are the panel's."""
    said: list[tuple[int, NotSeen]] = []
    for blobs in find_blobs(view.infrared, lens):
        try:
            return blobs, identify_spots(blobs, view.depth_m, lens.ray_image(), panel, view.name)
        except NotSeen as error:
            error.view, error.blobs = view, blobs
            said.append((len(blobs), error))
            if error.final:
                break
    # of all thresholds the one that came nearest to four spots shows best what is wrong
    raise min(said, key=lambda item: abs(item[0] - 4))[1]


def mean_frame(frames: list[Frame], about: FloatArray) -> Frame:
    """Mean of transforms: rotation by chordal mean, shift at the middle of points (n, 3)."""
    R, middle = nearest_rotation(np.mean([each.R for each in frames], axis=0)), about.mean(axis=0)
    return Frame(R, np.mean([each.R @ middle + each.origin for each in frames], axis=0) - R @ middle)


#: From the panel's places this far away the answer is judged, m: the volume in which an arm moves.
WITHIN_M = 1.0
#: Two sigmas of a position that are good for comparing arm motion to a centimetre, or still usable, m.
GOOD_M, USABLE_M = 0.003, 0.010
#: Two sigmas of the rotation likewise, degrees.
GOOD_DEG, USABLE_DEG = 0.3, 1.0
#: Misfits (squared residuals over what is expected) from which poses contradict each other.
CONTRADICTS = 4.0
#: The panel's definition is off by more than this, m.
DEFINITION_M = 0.002
#: Enough poses, and enough spread of their normals, degrees.
ENOUGH_POSES, ENOUGH_SPREAD_DEG = 4, 15.0
MORE_POSES = "record 4 to 8 poses: error falls with their number, and the depth's constant error is found"


class PanelAccuracy(NamedTuple):
    """Standard deviations of the answer."""

    rotation_deg: FloatArray  # (3,) degrees: about the camera's axes
    translation_m: FloatArray  # (3,) m: of the mocap's origin in the camera frame
    at_panel_m: FloatArray  # (3,) m: of a point in the middle of the panel's places
    within_m: float  # Square root of the trace for the worst point `WITHIN_M` away from there
    # (6, 6): Of a small rotation about the camera's axes (rad) and of the translation (m)
    covariance: FloatArray


def accuracy(calibration: PanelCalibration) -> PanelAccuracy:
    """Sigmas of the answer at the mocap's origin, at the panel and about it."""
    solution = calibration.solution
    middle = np.mean([found.points_K.mean(axis=0) for found in calibration.seen], axis=0)

    def at(point: FloatArray) -> FloatArray:
        """Covariance (6, 6) of the small rotation and of what it and the shift do to a point in {K}."""
        J = np.eye(6)
        J[3:, :3] = -skew(point)
        return np.asarray(J @ solution.covariance @ J.T)

    at_origin = at(solution.camera_from_mocap.origin)
    about = middle + WITHIN_M * np.array([*np.eye(3), *-np.eye(3)])
    return PanelAccuracy(
        rotation_deg=np.degrees(np.sqrt(np.diag(solution.covariance)[:3])),
        translation_m=np.sqrt(np.diag(at_origin)[3:]),
        at_panel_m=np.sqrt(np.diag(at(middle))[3:]),
        within_m=float(np.sqrt(max(float(np.trace(at(point)[3:, 3:])) for point in about))),
        covariance=at_origin,
    )


NAME = "camera_from_mocap"


def panel_answer(calibration: PanelCalibration) -> Answer:
    """Camera from mocap, p_camera = R p_mocap + t, m; camera optical, x right, y down, z forward."""
    found, solution, seen = accuracy(calibration), calibration.solution, calibration.seen
    rotation = 2 * float(np.linalg.norm(found.rotation_deg))
    position = 2 * found.within_m
    misfit = (solution.misfit, CONTRADICTS, 3 * CONTRADICTS)
    grade = graded((rotation, GOOD_DEG, USABLE_DEG), (position, GOOD_M, USABLE_M), misfit)
    sentence = (
        f"Rotation within {rotation:.2f} degrees, positions within"
        f" {2e3 * float(np.linalg.norm(found.at_panel_m)):.1f} mm at the panel and {1e3 * position:.1f} mm"
        f" {WITHIN_M:.0f} m away from it (two sigmas): {grade} for comparing arm motion with motion capture"
    )
    table = _transform_values(solution.camera_from_mocap) | {
        "rotation_sigma_deg": found.rotation_deg.tolist(),
        "translation_sigma_m": found.translation_m.tolist(),
        "position_sigma_at_panel_m": found.at_panel_m.tolist(),
        "covariance": found.covariance.tolist(),
        "poses": len(seen),
        "misfit": _rounded(solution.misfit),
        "grade": grade,
        "verdict": sentence,
    }
    if np.isfinite(solution.depth_offset_sigma_m):
        table["depth_offset_m"] = float(solution.depth_offset_m)
        table["depth_offset_sigma_m"] = float(solution.depth_offset_sigma_m)
    table["residuals"] = [
        {
            "pose": calibration.names[number],
            "markers": list(calibration.labels[number]),
            "distance_m": round(each.distance_m, 4),
            "tilt_deg": round(each.tilt_deg, 2),
            "pixels_rms": _rms(calibration.lens.focal_px * solution.ray_residuals[number]),
            "markers_rms_m": _rms(solution.marker_residuals_m[number]),
            "plane_rms_m": _rms(solution.plane_residuals_m[number]),
            "depth_noise_m": _rounded(each.plane.noise_m),
            "depth_pixels": int(each.plane.inliers.sum()),
        }
        for number, each in enumerate(seen)
    ]
    if calibration.published is not None:
        table["published"] = _transform_values(calibration.published)
    file = CalibrationFile().with_table(NAME, table)
    return Answer(grade, sentence, list(_checks(calibration)), file, {NAME: table})


def _checks(calibration: PanelCalibration) -> Iterator[Check]:
    """What is looked at, against its bounds."""
    solution, seen = calibration.solution, calibration.seen
    yield Check("poses of the panel", len(seen), ENOUGH_POSES, "", MORE_POSES, at_least=True)
    if not np.isfinite(solution.depth_offset_sigma_m):
        offset, sigma = 1e3 * solution.offset_apart_m, 1e3 * solution.offset_apart_sigma_m
        text = f"a constant error of the camera's depth ({offset:+.1f} +- {sigma:.1f} mm by this pose)"
        yield Check(text, remedy=MORE_POSES, is_open=True)
    residuals = solution.marker_residuals_m
    pose, marker = np.unravel_index(np.argmax(residuals), residuals.shape)
    worst = f"{calibration.labels[pose][marker]} of {calibration.names[pose]}"
    name = f"residuals over the stated noise (worst: marker {worst}, {1e3 * residuals.max():.1f} mm off)"
    yield Check(name, np.sqrt(solution.misfit), np.sqrt(CONTRADICTS), "", f"try without {worst}")
    ends = np.array(list(combinations(range(4), 2))).T
    wanted, *measured = (
        np.linalg.norm(at[ends[0]] - at[ends[1]], axis=1)
        for at in (calibration.panel.markers_P, *calibration.markers_E)
    )
    shape = max(float(np.sqrt(np.mean((each - wanted) ** 2))) for each in measured)
    yield Check("markers' distances off the panel's definition (rms)", 1e3 * shape, 1e3 * DEFINITION_M, "mm")
    for name, each in zip(calibration.names, seen, strict=True):
        yield Check(f"{name}: turned from the camera", each.tilt_deg, 45.0, "degrees", TURN_IT)
    far = max(each.distance_m for each in seen)
    yield Check("farthest pose", far, 2.5, "m", "hold the panel nearer: depth is better there")
    if len(seen) > 1:
        normals = np.array([each.plane.normal for each in seen])
        spread = float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1).min())))
        yield Check("spread of the panel's normals", spread, ENOUGH_SPREAD_DEG, "degrees",
                      "tilt the panel about 20 degrees to different sides", at_least=True)  # fmt: skip
        middles = np.array([each.points_K.mean(axis=0) for each in seen])
        yield Check("spread of the panel's places", float(np.ptp(middles, axis=0).max()), 0.3, "m",
                      "spread the poses over the arm's volume", at_least=True)  # fmt: skip
    ours, theirs = solution.camera_from_mocap, calibration.published
    if theirs is None:
        yield Check("the published method has too few depth points along the arms")
        return
    angle = float(np.degrees(Rotation.from_matrix(ours.R @ theirs.R.T).magnitude()))
    middle = np.mean(np.concatenate(calibration.markers_E), axis=0)
    apart = 1e3 * float(np.linalg.norm((ours.R - theirs.R) @ middle + ours.origin - theirs.origin))
    yield Check(
        f"the published method (principal components of regions) differs by {angle:.2f} degrees and"
        f" {apart:.1f} mm at the panel"
    )


def _transform_values(transform: Frame) -> dict[str, Any]:
    """Rotation (qw, qx, qy, qz) and translation (m)."""
    quaternion = Rotation.from_matrix(transform.R).as_quat(canonical=True, scalar_first=True)
    return {"rotation": quaternion.tolist(), "translation": transform.origin.tolist()}


def _rms(values: np.ndarray) -> float:
    return _rounded(float(np.sqrt(np.mean(np.square(values)))))


def _rounded(value: float) -> float:
    """Four digits: residuals are for reading."""
    return float(f"{value:.4g}")
