"""`write_calibration_page`: the page of any calibration, with its verdict first."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from calib.clock.clock_calibration import ClockCalibration
from calib.forearm.held_pose import ForearmCalibration
from calib.imu.magnetometer import MagnetometerCalibration
from calib.imu.sensor_calibration import ImuCalibration
from calib.panel.panel_calibration import PanelCalibration
from calib.world.world_calibration import WorldCalibration

from .clock import clock_page
from .forearm import forearm_page
from .imu import imu_page, magnetometer_page
from .panel import panel_page, world_page
from .sheet import Page, write_sheet

#: What makes the page of each kind of calibration.
PAGES: dict[type, Callable[..., Page]] = {
    ClockCalibration: clock_page,
    ForearmCalibration: forearm_page,
    ImuCalibration: imu_page,
    MagnetometerCalibration: magnetometer_page,
    PanelCalibration: panel_page,
    WorldCalibration: world_page,
}


def write_calibration_page(
    path: str | os.PathLike[str], calibration: Any, *inputs: Any, force: bool = False
) -> None:
    """Write the page of a calibration.

    Parameters
    ----------
    path : path-like
        The page to write.
    calibration : ClockCalibration, ForearmCalibration, ImuCalibration, ..
        One of `PAGES`.
    *inputs
        What it was made of, as its function in `PAGES` takes it.
    force : bool
        Overwrite a page that exists.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    page = PAGES[type(calibration)](calibration, *inputs)
    write_sheet(path, page.title, page.subtitle, page.verdict, page.sections, force=force)
