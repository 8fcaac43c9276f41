"""Camera to mocap from views of the marker panel (JA II-F.1, refined): the whole method on one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.array_types import FloatArray
from smoother.linalg import nearest_rotation

from ..intrinsics import Intrinsics
from .definition import Frame, Panel, fit_frame, frame_of_markers, frame_of_points
from .identify import (
    EDGE_ON_DEG,
    SEE_DEPTH,
    TURN_IT,
    DepthMissing,
    EdgeOn,
    NotSeen,
    Reading,
    identify_markers,
    identify_spots,
)
from .images import Blobs, View, check_size, find_blobs
from .panel_graph import PanelSolution, PoseData, solve
from .plane import Plane, Regions, fit_plane, panel_regions
from .plane import regions_on_plane as on_plane

#: Noise of a mocap marker where nothing else is said, m per axis.
MOCAP_SIGMA_M = 0.0002
#: Less of the panel than this with depth is as good as none.
LEAST_COVERED = 0.15


@dataclass(frozen=True)
class SeenPanel:
    """The panel in one view."""

    blobs: Blobs  # All bright spots
    spots: tuple[int, ...]  # Those of the four markers, in the panel's order
    reading: Reading  # How well their distances fit the panel's
    regions: Regions  # Its depth pixels and the plane through them
    plane: Plane  # Its depth pixels and the plane through them
    points_K: FloatArray  # (4, 3) m: the markers in the camera frame
    frame: Frame  # The panel's axes and {P}'s origin in the camera frame, by markers and plane
    published: Frame | None  # The same as published, by principal components; its origin is the first marker
    tilt_deg: float  # Between the panel's normal and the line of sight
    distance_m: float  # Of the markers' middle from the camera

    @property
    def pixels(self) -> FloatArray:
        """(4, 2) pixels of the markers, in the panel's order."""
        return self.blobs.pixels[list(self.spots)]


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
    chosen = [choose_markers(each, panel, view.name) for each, view in zip(markers, views, strict=True)]
    seen = [see_panel(view, panel, lens) for view in views]
    markers_E = [
        np.array([each[label] for label in labels]) for each, labels in zip(markers, chosen, strict=True)
    ]
    solution = solve(
        [
            pose_data(found, at, panel, lens, mocap_sigma_m, view.name)
            for found, at, view in zip(seen, markers_E, views, strict=True)
        ]
    )
    published = [
        found.published.after(frame_of_markers(at, panel))
        for found, at in zip(seen, markers_E, strict=True)
        if found.published is not None
    ]
    return PanelCalibration(
        solution=solution,
        published=_mean(published, markers_E) if published else None,
        seen=tuple(seen),
        markers_E=tuple(markers_E),
        labels=tuple(chosen),
        names=tuple(view.name for view in views),
        panel=panel,
        lens=lens,
    )


def see_panel(view: View, panel: Panel, lens: Intrinsics) -> SeenPanel:
    """Find the panel in a view: spots, which is which, regions, plane, axes."""
    check_size(view, lens)
    blobs, reading, first = _spots(view, panel, lens)
    spots = list(reading.index)
    frame = fit_frame(first, panel)
    # the markers' places are read off the depth between them; then the whole panel's depth is used
    for _ in range(2):
        regions = panel_regions(view.depth_m, lens, blobs, panel, frame)
        if regions.covered < LEAST_COVERED:
            raise DepthMissing(
                f"{view.name}: depth is missing under the panel: {100 * regions.covered:.0f} % of it has one;"
                f" {SEE_DEPTH}"
            )
        plane = fit_plane(regions.pixels, regions.rays, regions.depth_m, view.name)
        points = _on_panel(plane, blobs.rays[spots], panel.height_m)
        frame = fit_frame(points, panel)
    middle = points.mean(axis=0)
    distance = float(np.linalg.norm(middle))
    tilt = float(np.degrees(np.arccos(np.clip(-(plane.normal @ middle) / distance, -1, 1))))
    if tilt > EDGE_ON_DEG:
        raise EdgeOn(
            f"{view.name}: the panel is seen edge-on, {tilt:.0f} degrees from facing the camera; {TURN_IT}"
        )
    inside = plane.inliers
    regions = on_plane(regions, inside, panel)
    full = np.column_stack([regions.rays, np.ones(len(regions.rays))])[inside] * regions.depth_m[inside, None]
    published = frame_of_points(full, regions.along_x[inside], regions.along_y[inside], frame.R)
    if published is not None:
        published = Frame(published.R, published.origin + panel.height_m * published.R[:, 2])
    return SeenPanel(blobs, reading.index, reading, regions, plane, points, frame, published, tilt, distance)


def choose_markers(markers: dict[str, FloatArray], panel: Panel, name: str) -> tuple[str, ...]:
    """Names of the mocap markers that are the panel's, in the panel's order."""
    labels = list(markers)
    at = np.array([markers[label] for label in labels]).reshape(-1, 3)
    reading = identify_markers(at, panel, name)
    return tuple(labels[index] for index in reading.index)


def pose_data(
    seen: SeenPanel, markers_E: FloatArray, panel: Panel, lens: Intrinsics, sigma_E_m: float, name: str
) -> PoseData:
    """What the graph takes of a pose."""
    spots = list(seen.spots)
    return PoseData(
        rays=seen.blobs.rays[spots],
        sigmas=seen.blobs.sigmas_px[spots] / lens.focal_px,
        plane=seen.plane,
        markers_E=markers_E,
        sigma_E_m=sigma_E_m,
        height_m=panel.height_m,
        name=name,
    )


def _spots(view: View, panel: Panel, lens: Intrinsics) -> tuple[Blobs, Reading, FloatArray]:
    """Bright spots at the first threshold at which four of them are the panel's."""
    said: list[tuple[int, NotSeen]] = []
    for blobs in find_blobs(view.infrared, lens):
        try:
            return blobs, *identify_spots(blobs, view.depth_m, lens.ray_image(), panel, view.name)
        except NotSeen as error:
            error.add(view, blobs)
            said.append((len(blobs), error))
            if error.final:
                break
    # of all thresholds the one that came nearest to four spots shows best what is wrong
    raise min(said, key=lambda item: abs(item[0] - 4))[1]


def _on_panel(plane: Plane, rays: FloatArray, height_m: float) -> FloatArray:
    theta = plane.theta / (1 - height_m * float(np.linalg.norm(plane.theta)))
    full = np.column_stack([rays, np.ones(len(rays))])
    return full / (full @ theta)[:, None]


def _mean(frames: list[Frame], markers_E: list[FloatArray]) -> Frame:
    """Mean of transforms: rotation by chordal mean, shift at the markers' middle."""
    R = nearest_rotation(np.mean([each.R for each in frames], axis=0))
    middle = np.mean(np.concatenate(markers_E), axis=0)
    at = np.mean([each.R @ middle + each.origin for each in frames], axis=0)
    return Frame(R, at - R @ middle)
