"""Whether a recording's real gaps are harder than those that were hidden for a test.

The camera loses an arm when it moves fast, turns away or passes behind something; gaps can only be hidden
where it saw the arm. The IMU feels both kinds: how fast the forearm turned and was accelerated in real gaps
against hidden ones says how far the test flatters, and how the errors of the hidden gaps grow with movement
says what that costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ..array_types import FloatArray
from ..measurements.visibility import accepted_samples, find_gaps, visible_frames
from ..recording import Recording
from ..units import GRAVITY
from .gap_table import GapRow, GapTable

#: Real gaps shorter than this are flicker, s.
SHORTEST_S = 0.2
#: Errors against movement are only fitted to so many hidden gaps, and believed from so many sigmas on.
FEWEST_GAPS, FIRM_SIGMAS = 20, 2.0
#: How errors may grow with movement: as its power.
STEEPEST = 1.5
#: A difference below this deserves no warning.
ALIKE = 1.15


@dataclass(frozen=True)
class RealGaps:
    """Movement in the real gaps of some recordings against their hidden ones.

    Attributes
    ----------
    count : int
        Real gaps.
    turning_ratio, acceleration_ratio : float or None
        Rms turn rate, and rms of specific force less gravity's size, in real gaps over those in hidden ones.
    error_ratio : float or None
        How much larger errors are to be expected in real gaps; None where hidden gaps do not say.
    """

    count: int
    turning_ratio: float | None = None
    acceleration_ratio: float | None = None
    error_ratio: float | None = None

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values by name."""
        return asdict(self)

    @property
    def sentence(self) -> str:
        """What a reader must know of it."""
        start = "gaps were hidden where the camera saw the arm, which is easier than where it lost it"
        if self.turning_ratio is None or self.acceleration_ratio is None:
            return f"{start}: real gaps may be worse, and no real gap here says by how much"
        where = "the real gap" if self.count == 1 else f"its {self.count} real gaps"
        movement = (
            f"in {where} the forearm turned {self.turning_ratio:.1f} times as fast and was"
            f" accelerated {self.acceleration_ratio:.1f} times as strongly"
        )
        if self.error_ratio is not None:
            return f"{start}: {movement}, so expect errors {self.error_ratio:.1f} times those of the table"
        if max(self.turning_ratio, self.acceleration_ratio) < ALIKE:
            return f"{start}; here the IMU feels no difference: {movement}"
        return f"{start}: {movement}, so expect larger errors there"


def compare_real_gaps(recordings: Sequence[Recording], table: GapTable, method: str = "graph") -> RealGaps:
    """Movement in real gaps against hidden ones, over some recordings.

    Parameters
    ----------
    recordings : sequence of Recording
        As they were, nothing hidden.
    table : GapTable
        Of these recordings.
    method : str
        Whose errors count.

    Returns
    -------
    comparison : RealGaps
    """
    by_name = {recording.name: recording for recording in recordings}
    real = [
        movement
        for recording in recordings
        for start_s, end_s in _real_gaps(recording)
        if (movement := _movement(recording, start_s, end_s)) is not None
    ]
    rows = [row for row in table.rows if row.method == method and not row.failure]
    rows = rows or [row for row in table.rows if not row.failure]
    hidden = [
        (row, movement)
        for row in rows
        if (movement := _movement(by_name[row.recording], row.gap.start_s, row.gap.end_s)) is not None
    ]
    if not real or not hidden:
        return RealGaps(len(real))
    ratio = _rms(np.array(real)) / np.maximum(_rms(np.array([movement for _, movement in hidden])), 1e-6)
    power = _growth([row for row, _ in hidden], np.array([movement[0] for _, movement in hidden]))
    return RealGaps(
        len(real),
        float(ratio[0]),
        float(ratio[1]),
        None if power is None else float(max(ratio[0], 1e-6) ** power),
    )


def _real_gaps(recording: Recording) -> list[tuple[float, float]]:
    """Start and end of the gaps with the arm seen on both sides, on the camera's clock, s."""
    arm, imu = recording.arm, recording.imu
    if not len(arm) or not len(imu):
        return []
    start_s, end_s = max(arm.t_s[0], imu.t_s[0]), min(arm.t_s[-1], imu.t_s[-1])
    gaps = find_gaps(arm.t_s, visible_frames(arm, accepted_samples(arm)), float(start_s), float(end_s))
    closed = [gap for gap in gaps if not gap.open_start and not gap.open_end]
    return [(gap.start_s, gap.end_s) for gap in closed if gap.length_s >= SHORTEST_S]


def _movement(recording: Recording, start_s: float, end_s: float) -> tuple[float, float] | None:
    """Rms turn rate, rad/s, and rms of specific force less gravity's size, m/s^2; None without samples."""
    first, last = np.searchsorted(recording.imu.t_s, [start_s, end_s])
    if last - first < 3:
        return None
    gyro, acc = recording.imu.gyro[first:last], recording.imu.acc[first:last]
    turning = np.sqrt(np.mean(np.sum(np.square(gyro), axis=1)))
    return float(turning), float(np.sqrt(np.mean((np.linalg.norm(acc, axis=1) - GRAVITY) ** 2)))


def _rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _growth(rows: Sequence[GapRow], turning: FloatArray) -> float | None:
    """With which power errors grow with the turn rate, at equal lengths; None where that is not firm."""
    error = np.array([row.figures.position_rms_m or np.nan for row in rows], dtype=float)
    good = np.isfinite(error) & (error > 0) & (turning > 0)
    if good.sum() < FEWEST_GAPS:
        return None
    length = np.array([row.length_s for row in rows])[good]
    design = np.column_stack(
        [np.log(turning[good]), *[(length == each).astype(float) for each in np.unique(length)]]
    )
    solution, *_ = np.linalg.lstsq(design, np.log(error[good]), rcond=None)
    left = np.log(error[good]) - design @ solution
    variance = left @ left / max(len(left) - design.shape[1], 1)
    sigma = float(np.sqrt(variance * np.linalg.pinv(design.T @ design)[0, 0]))
    power = float(solution[0])
    return min(power, STEEPEST) if power > FIRM_SIGMAS * sigma else None
