"""The windows of one round of self-calibration: segments prepared and cut, and put together again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray, IntArray
from ..calibration import ArmCalibration
from ..config import Config
from ..errors import CalibrationError
from ..measurements.clock import Clock
from ..measurements.segment import Segment
from ..units import GRAVITY
from ..window.cut import PreparedSegment, cut, cut_times
from ..window.prepare import prepare
from ..window.priors import InitialValues, first_priors, initial_values, noise_of
from ..window.problem import Priors, Window
from ..window.solution import Solution
from ..window.trajectory import Trajectory, at_times, merge_windows


@dataclass(frozen=True)
class RoundWindows:
    """The windows of a round, segment after segment.

    `borders` and `prepared`: one a segment; `recording_of_window`: one a window.
    """

    prepared: dict[int, PreparedSegment]
    borders: list[list[float]]
    windows: list[Window]
    recording_of_window: IntArray
    initial: InitialValues
    prior: Priors

    def trajectories(self, solutions: Sequence[Solution]) -> dict[int, Trajectory]:
        """The joined trajectory of each segment, by its number."""
        merged, first = {}, 0
        for (number, prepared), border in zip(self.prepared.items(), self.borders, strict=True):
            last = first + len(border) - 1
            merged[number] = merge_windows(prepared.t, self.windows[first:last], list(solutions[first:last]))
            first = last
        return merged


def cut_round(
    segments: dict[int, Segment],
    calibration: ArmCalibration,
    clocks: Sequence[Clock],
    joint_sigma_m: FloatArray,
    upper_arm_sigma_m: float,
    trajectories: dict[int, Trajectory],
    config: Config,
) -> RoundWindows:
    """Prepare and cut all segments; start values are the last round's trajectories where there are any."""
    margin_s = config.windows.margin_s
    ready = [
        (number, segment, *answer)
        for number, segment in segments.items()
        if (answer := prepare(segment, calibration, clocks[segment.recording], joint_sigma_m, margin_s))
    ]
    if not ready:
        raise CalibrationError("at no time do the IMU and a visible forearm come together")
    prepared = {number: with_initial_values(each, trajectories.get(number)) for number, _, each, _ in ready}
    initial = initial_values(
        list(prepared.values()),
        [alignment for *_, alignment in ready],
        [segment for _, segment, *_ in ready],
    )
    prior = first_priors(initial, calibration, config)
    noise = noise_of(config, upper_arm_sigma_m)
    borders = [cut_times(each, config.windows.length_s) for each in prepared.values()]
    sharing = sum(len(border) - 1 for border in borders)
    windows: list[Window] = []
    recording: list[int] = []
    for (_, segment, *_), each, border in zip(ready, prepared.values(), borders, strict=True):
        windows += cut(each, [prior] * (len(border) - 1), noise, border, margin_s, GRAVITY, sharing)
        recording += [segment.recording] * (len(border) - 1)
    return RoundWindows(prepared, borders, windows, np.array(recording), initial, prior)


def with_initial_values(prepared: PreparedSegment, trajectory: Trajectory | None) -> PreparedSegment:
    """The segment with an earlier solution's trajectory as start values; as it is without one."""
    if trajectory is None:
        return prepared
    inside = np.clip(prepared.t, trajectory.t[0], trajectory.t[-1])
    return replace(prepared, start=at_times(trajectory, prepared.signal, inside))
