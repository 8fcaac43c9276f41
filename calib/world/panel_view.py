"""The panel's rotation in the camera, with its covariance, from what the camera saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import skew
from smoother.recording import ImuStream

from ..file import CalibrationFile
from ..imu.sensor import corrected_streams
from ..intrinsics import Intrinsics
from ..panel.definition import Panel
from ..panel.images import View
from ..panel.panel_calibration import SeenPanel, see_panel
from .chain import BIAS_M_S2, CORRECTED_M_S2
from .world_calibration import PanelView, WorldCalibration, calibrate_world, world_poses

#: A rotation is not known better than this: lens, and the shape of the panel, rad.
FLOOR_RAD = np.radians(0.03)


def calibrate_world_from_views(
    views: Sequence[View],
    t_s: Sequence[float],
    panel_imu: Sequence[ImuStream],
    base_imu: Sequence[ImuStream],
    panel: Panel,
    lens: Intrinsics,
    file: CalibrationFile | None = None,
) -> WorldCalibration:
    """Camera from base IMU from images of the panel and the IMUs' samples (JA II-F.2)."""
    file = file or CalibrationFile()
    panel_imu, panel_known = corrected_streams(panel_imu, file)
    base_imu, base_known = corrected_streams(base_imu, file)
    poses, notes = world_poses(
        [view_panel(view, at, panel, lens) for view, at in zip(views, t_s, strict=True)], panel_imu, base_imu
    )
    found = calibrate_world(poses, notes, CORRECTED_M_S2 if panel_known and base_known else BIAS_M_S2)
    return replace(found, accelerometer_corrected=base_known)


def common_time(panel_imu: ImuStream, base_imu: ImuStream) -> float:
    """The middle of the time in which both IMUs were recorded, s: when a pose of its own was held."""
    first, last = max(panel_imu.t_s[0], base_imu.t_s[0]), min(panel_imu.t_s[-1], base_imu.t_s[-1])
    if last <= first:
        raise CalibrationError("the IMUs' samples do not overlap in time")
    return 0.5 * float(first + last)


def view_panel(view: View, t_s: float, panel: Panel, lens: Intrinsics) -> PanelView:
    """Find the panel in a pair of images."""
    seen = see_panel(view, panel, lens)
    return PanelView(view.name, t_s, seen.frame.R, rotation_covariance(seen, lens))


def rotation_covariance(seen: SeenPanel, lens: Intrinsics) -> FloatArray:
    """Covariance (3, 3) of the panel's rotation vector, rad^2 in {K}."""
    theta = seen.plane.theta
    size = float(np.linalg.norm(theta))
    n = theta / size
    slope = skew(n) @ (np.eye(3) - np.outer(n, n)) / size
    arms = seen.points_K - seen.points_K.mean(axis=0)
    sigma_m = seen.blobs.sigmas_px[list(seen.spots)] / lens.focal_px * seen.points_K[:, 2]
    about_n = 1 / float(((arms**2).sum(axis=1) / sigma_m**2).sum())
    covariance = slope @ seen.plane.covariance @ slope.T + about_n * np.outer(n, n)
    return np.asarray(covariance + FLOOR_RAD**2 * np.eye(3))
