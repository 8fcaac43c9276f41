"""The live smoother: samples in, the arm now and a lag ago out."""

from __future__ import annotations

from types import TracebackType

from ..calibration import ArmCalibration
from ..config import Config
from ..recording import CameraFrame, FloatArray
from .calibrator import Calibrator
from .imu_batch import ImuBatch
from .live_state import LiveState
from .output import LiveOutput
from .skeleton_frame import SkeletonFrame


class LiveSmoother:
    """A fixed-lag smoother that calibrates itself; use as a context manager.

    It takes its times from the data and from `step`, never from this computer's clock, so that a recording
    played faster or slower gives the same answer.

    Parameters
    ----------
    side : {"left", "right", ""}
        Which arm.
    calibration : ArmCalibration, optional
        What is known beforehand; what it lacks is solved from the first seconds.
    config : Config, optional
        Settings, as of `smooth`.
    lag_s : float, s
        How long before the present `settled` is; 0 to 2.
    gravity_hint : ndarray, shape (3,), optional
        Direction of down in {K}, good to some degrees.
    camera_frame : CameraFrame, optional
        The convention of the camera's axes.
    calibrator : Calibrator, optional
        Who works the self-calibration out; a process in the background where None.

    Raises
    ------
    ConfigError
        The lag is not between 0 and 2 s.
    """

    def __init__(
        self,
        side: str = "",
        calibration: ArmCalibration | None = None,
        config: Config | None = None,
        lag_s: float = 0.2,
        gravity_hint: FloatArray | None = None,
        camera_frame: CameraFrame | None = None,
        calibrator: Calibrator | None = None,
    ) -> None:
        raise NotImplementedError

    def __enter__(self) -> LiveSmoother:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.finish()

    def add_imu(self, batch: ImuBatch) -> None:
        """Take samples in, in any order; those older than half a second before the newest are dropped."""
        raise NotImplementedError

    def add_frame(self, frame: SkeletonFrame) -> None:
        """Take a frame in, in any order; one older than half a second before the newest is dropped."""
        raise NotImplementedError

    def step(self, now_s: float) -> LiveOutput:
        """Work in what has arrived, and answer for the present.

        Parameters
        ----------
        now_s : float, s
            The present on the IMU's clock; call it about as often as an answer is wanted (30 to 100 Hz).
        """
        raise NotImplementedError

    @property
    def state(self) -> LiveState:
        """As of the last step."""
        raise NotImplementedError

    def finish(self) -> None:
        """End the background's work."""
        raise NotImplementedError
