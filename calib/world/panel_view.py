"""The panel's rotation in the camera, with its covariance, from what the camera saw."""

from __future__ import annotations

import numpy as np

from smoother.recording import FloatArray

from ..panel.definition import Intrinsics, Panel
from ..panel.images import View
from ..panel.panel_calibration import SeenPanel, see_panel
from .world_calibration import PanelView

#: A rotation is not known better than this: lens, and the shape of the panel, rad.
FLOOR_RAD = np.radians(0.03)


def view_panel(view: View, t_s: float, panel: Panel, lens: Intrinsics) -> PanelView:
    """Find the panel in a pair of images.

    Parameters
    ----------
    t_s : time of the images on the IMUs' clock.

    Raises
    ------
    CalibrationError
        See `see_panel`.
    """
    seen = see_panel(view, panel, lens)
    return PanelView(view.name, t_s, seen.frame.R, rotation_covariance(seen, lens))


def rotation_covariance(seen: SeenPanel, lens: Intrinsics) -> FloatArray:
    """Covariance (3, 3) of the panel's rotation vector, rad^2 in {K}.

    The plane tells the tilt, n = theta / |theta|; the markers' pixels tell the turn about n.
    """
    theta = seen.plane.theta
    size = float(np.linalg.norm(theta))
    x, y, z = n = theta / size
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    slope = skew @ (np.eye(3) - np.outer(n, n)) / size
    arms = seen.points_K - seen.points_K.mean(axis=0)
    sigma_m = seen.blobs.sigmas_px[list(seen.spots)] / lens.focal_px * seen.points_K[:, 2]
    about_n = 1 / float(((arms**2).sum(axis=1) / sigma_m**2).sum())
    covariance = slope @ seen.plane.covariance @ slope.T + about_n * np.outer(n, n)
    return np.asarray(covariance + FLOOR_RAD**2 * np.eye(3))
