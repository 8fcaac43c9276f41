"""Colour and depth images of a simulated arm with its strap, beside the arm's recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.intrinsics import Intrinsics, PlacedCamera

from ..array_types import FloatArray
from .arm import SimulatedArm
from .strap import Arm, StrapImageNoise, render

#: The skeleton's axes are the Kinect's: x left, y up; images have x right, y down.
_KINECT = np.diag([-1.0, -1.0, 1.0])
#: The colour camera stands beside the depth camera, m along x.
BASELINE_M = 0.05
COLOUR = PlacedCamera(
    Intrinsics(480, 270, 400.0, 400.0, 240.0, 135.0), _KINECT, np.array([BASELINE_M, 0.0, 0.0])
)
DEPTH = PlacedCamera(Intrinsics(320, 288, 260.0, 260.0, 160.0, 144.0), _KINECT)
#: The depth image follows the colour image after this, s.
DEPTH_LATER_S = 0.002


@dataclass(frozen=True)
class StrapImages:
    """A colour image and the depth image after it.

    Attributes
    ----------
    t_s : float, s
        Of the colour image, on the camera's clock.
    grey : ndarray of uint8, shape (height, width)
        Brightness.
    depth_mm : ndarray of uint16, shape (height, width), mm
        0 where there is none.
    """

    t_s: float
    grey: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16]


def strap_images(simulated: SimulatedArm, times: FloatArray, seed: int = 0) -> Iterator[StrapImages]:
    """Render the arm at some of the camera's times, the strap where the IMU is.

    Parameters
    ----------
    simulated : SimulatedArm
        With truth; its camera's frame is "kinect".
    times : ndarray, shape (n,), s
        On the camera's clock.
    seed : int
        Of the images' noise.

    Yields
    ------
    StrapImages
        In order of time.
    """
    rng, truth, measures = np.random.default_rng(seed), simulated.recording.truth, simulated.parameters
    assert truth is not None
    radius_m = strap_radius_m(simulated)
    for t in times.tolist():
        k = int(np.argmin(np.abs(truth.t_s - t)))
        elbow, wrist = truth.joints["elbow"][k], truth.joints["wrist"][k]
        arm = Arm(elbow, wrist, radius_m, measures["forearm_m"] - measures["strap_to_wrist_m"])
        noise = StrapImageNoise(rng=rng)
        grey, _ = render(arm, COLOUR, noise)
        _, z = render(arm, DEPTH, noise)
        yield StrapImages(t, grey, np.nan_to_num(np.rint(1000 * z)).astype(np.uint16))


def strap_radius_m(simulated: SimulatedArm) -> float:
    """From the forearm's core to the IMU, m."""
    elbow, wrist = (simulated.calibration.lever_arms[joint].position_m for joint in ("elbow", "wrist"))
    y = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    return float(np.linalg.norm(elbow - (elbow @ y) * y))
