"""What one step of the live smoother answers."""

from __future__ import annotations

from dataclasses import dataclass, field

from .estimate import LiveEstimate
from .live_state import LiveState


@dataclass(frozen=True)
class Dropped:
    """What never took part, counted since the beginning.

    Attributes
    ----------
    late_samples, late_frames : int
        Older than the smoother sorts in.
    duplicate_samples, duplicate_frames : int
        A stamp that had been there before.
    invalid_samples : int
        Not finite.
    backlog_frames : int
        Skipped to catch up with the present.
    """

    late_samples: int = 0
    late_frames: int = 0
    duplicate_samples: int = 0
    duplicate_frames: int = 0
    invalid_samples: int = 0
    backlog_frames: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return (
            self.late_samples
            + self.late_frames
            + self.duplicate_samples
            + self.duplicate_frames
            + self.invalid_samples
            + self.backlog_frames
        )


@dataclass(frozen=True)
class LiveOutput:
    """What is known after a step.

    Attributes
    ----------
    now_s : float, s
        The present as the step was told it, on the IMU's clock.
    state : LiveState
        At the present.
    now : LiveEstimate or None
        Predicted to the present; None while calibrating, or with the IMU lost.
    settled : LiveEstimate or None
        `lag_s` before the present; None as above, and until there is so much of an answer.
    clock_offset_s, clock_sigma_s : float, s
        t_imu = t_camera + offset, and its standard deviation; nan before it is known.
    camera_latency_s : float, s
        From a frame's moment to its arrival, median of the last frames; nan before it is known.
    imu_rate_hz, frame_rate_hz : float, Hz
        Of the last seconds; nan without samples.
    dropped : Dropped
        Since the beginning.
    load : float
        Processor time of the steps as a share of one core, over the last seconds.
    step_ms : float, ms
        Processor time of this step.
    notes : tuple of str
        What happened in this step and should be said, one sentence each ("the camera's clock jumped ..").
    calibration : str
        How the self-calibration stands, in words.
    """

    now_s: float
    state: LiveState
    now: LiveEstimate | None = None
    settled: LiveEstimate | None = None
    clock_offset_s: float = float("nan")
    clock_sigma_s: float = float("nan")
    camera_latency_s: float = float("nan")
    imu_rate_hz: float = float("nan")
    frame_rate_hz: float = float("nan")
    dropped: Dropped = field(default_factory=Dropped)
    load: float = float("nan")
    step_ms: float = float("nan")
    notes: tuple[str, ...] = ()
    calibration: str = ""
