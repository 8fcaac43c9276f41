"""A clock offset of any size, roughly: before the smoother looks for it within its own reach.

The forearm's direction turns as fast in the camera's frame as in any other, and never faster than the
gyroscope says. So the two speeds are correlated over all shifts that leave enough of both. Where the shift
whose correlation is the least likely to be chance is out of the fine search's reach, the likeliest ones and
none at all are tried on the closed form: the forearm's direction, not its speed alone, tells which is right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..errors import CalibrationError
from ..filters import gaussian_smoothed
from ..linalg import masked_correlation, peaks
from ..measurements.clock import LARGEST_OFFSET_S, Clock
from ..measurements.timeline import Timeline
from ..recording import ImuStream, JointTracks, Recording
from .closed_form import DIRECTION_DEG, closed_form
from .excerpts import spread_excerpts

#: Both speeds are taken on this grid, Hz, smoothed with this sigma, s: what joints' noise leaves of them.
GRID_HZ, SMOOTH_S = 50.0, 0.12
#: Frames farther apart are not bridged, s.
BRIDGED_S = 0.25
#: A speed that varies by less than this, of its variance over the whole, is at rest there.
AT_REST = 1e-2
#: Both must share so much, s, at a shift that is tried.
OVERLAP_S = 8.0
#: A shift is accepted from this correlation on; another peak as good as this part of it makes it doubtful.
CLEAR, RIVAL, PEAK_S = 0.6, 0.9, 1.0
#: Of shifts that are not clear the highest peaks are tried: so many, each at least this part of the highest;
#: the one that fits is accepted where the next leaves this times as large an angle.
PEAKS, PEAK_SHARE, PEAK_APART_S, BETTER = 8, 0.4, 0.3, 1.6
#: Of a recording longer than this only excerpts are looked at: so many, with so much around each, s; and with
#: so much of the IMU where that says nothing.
LONG_S, EXCERPTS, AROUND_S, FAR_S = 300.0, 12, 15.0, 600.0
#: The fine search finds what is left over when it is below this everywhere, s.
SMALL_S = 0.15
#: So many excerpts, and so much of those that are clear, have to lie within `SMALL_S` of a line.
FEWEST_EXCERPTS, AGREE = 3, 0.7


def synchronise_coarsely(
    recording: Recording, timeline: Timeline | None = None, measured: Clock | None = None
) -> tuple[Recording, Clock | None]:
    """Bring the camera's stamps to where the fine search finds the rest.

    Parameters
    ----------
    recording : Recording
        Its clocks may be any time apart.
    timeline : Timeline, optional
        Of the recording, where it is there already.
    measured : Clock, optional
        A clock that was measured otherwise; then nothing is looked for.

    Returns
    -------
    recording : Recording
        With the camera's stamps moved.
    clock : Clock or None
        How they were moved; None where they were near enough.

    Raises
    ------
    CalibrationError
        The clocks are farther apart than the fine search reaches, and the motion does not tell how far.
    """
    clock = measured or coarse_clock(recording, timeline)
    if clock is None:
        return recording, None
    return replace(recording, arm=replace(recording.arm, t_s=clock.to_imu(recording.arm.t_s))), clock


def coarse_clock(recording: Recording, timeline: Timeline | None = None) -> Clock | None:
    """The camera's clock to some tens of milliseconds; None where the fine search reaches it by itself.

    Over a long recording clocks drift apart: excerpts of it are looked at one by one, and a line is drawn
    through their offsets: the median of the slopes of all pairs, which a few wrong ones do not move (Theil
    and Sen; J. Am. Stat. Assoc. 1968).

    Raises
    ------
    CalibrationError
        See `coarse_offset`.
    """
    t = recording.arm.t_s
    if t[-1] - t[0] <= LONG_S:
        offset = coarse_offset(recording, LARGEST_OFFSET_S)
        return Clock(t[:1], np.array([offset]), SMALL_S) if offset else None
    timeline = timeline or Timeline.of(recording)
    rows = _excerpt_lags(recording, timeline, AROUND_S) or _excerpt_lags(recording, timeline, FAR_S)
    if not rows:
        return None
    at, lag = np.array(rows).T
    i, j = np.triu_indices(len(at), 1)
    slope = float(np.median((lag[j] - lag[i]) / (at[j] - at[i])))
    value = float(np.median(lag - slope * at))
    if np.mean(np.abs(lag - value - slope * at) < SMALL_S) < AGREE:
        return None
    ends = np.array([t[0], t[-1]])
    line = value + slope * ends
    return None if np.abs(line).max() < SMALL_S else Clock(ends, line, SMALL_S, skew=slope)


def _excerpt_lags(recording: Recording, timeline: Timeline, around_s: float) -> list[tuple[float, float]]:
    """Camera times and offsets of the excerpts that are clear, s; none where they are too few."""
    rows = []
    for excerpt in spread_excerpts(recording, timeline, EXCERPTS, AROUND_S, around_s):
        peak = _Peak.of(recording.imu.select(excerpt.samples), recording.arm.select(excerpt.frames))
        if peak is not None and peak.is_clear:
            rows.append((0.5 * (excerpt.start_s + excerpt.end_s), peak.lag_s))
    return rows if len(rows) >= FEWEST_EXCERPTS else []


def coarse_offset(recording: Recording, reach_s: float) -> float:
    """t_imu - t_camera to some tens of milliseconds; 0 where the fine search reaches it by itself.

    Parameters
    ----------
    recording : one arm with elbow and wrist, and its IMU; with `strap` alone nothing is looked for.
    reach_s : the fine search finds offsets up to this.

    Raises
    ------
    CalibrationError
        The clocks are farther apart than the fine search reaches, and the motion does not tell how far.
    """
    peak = _Peak.of(recording.imu, recording.arm)
    if peak is None or abs(peak.lag_s) <= reach_s:
        return 0.0
    # a few seconds of motion agree clearly by chance too: the forearm's direction decides, where it can
    fitting = _fitting_lag(recording, peak)
    if fitting is not None:
        return fitting if abs(fitting) > reach_s else 0.0
    if peak.is_clear:
        return 0.0 if _misfit_deg(recording, 0.0) < _misfit_deg(recording, peak.lag_s) else peak.lag_s
    within_reach = np.abs(peak.lags_s) <= reach_s
    if within_reach.any() and float(peak.score[within_reach].max()) >= RIVAL * peak.score.max():
        return 0.0  # the small offset explains the motion about as well
    if peak.correlation < CLEAR:
        return 0.0  # no shift stands out; what the fine search finds carries its own sigma
    raise CalibrationError(
        f"{recording.name}: the camera's clock and the IMU's seem {abs(peak.lag_s):.1f} s apart, but"
        " repeated motion fits other offsets as well; record 20 s of irregular motion in view"
    )


def _fitting_lag(recording: Recording, peak: _Peak) -> float | None:
    """The shift at which the forearm's direction fits, s; None where none does, or another about as well."""
    fits = [(_misfit_deg(recording, lag_s), lag_s) for lag_s in (0.0, *peak.highest_lags_s())]
    best_deg, best_s = min(fits)
    # what the closed form reaches from next to the best is no other shift
    others = [angle for angle, lag_s in fits if abs(lag_s - best_s) > 2.0 * LARGEST_OFFSET_S]
    is_alone = all(angle > max(BETTER * best_deg, DIRECTION_DEG) for angle in others)
    return best_s if best_deg < DIRECTION_DEG and is_alone else None


def _misfit_deg(recording: Recording, lag_s: float) -> float:
    """What the closed form leaves of the forearm's direction at a shift, degrees; infinite without one."""
    fit = closed_form(replace(recording, arm=replace(recording.arm, t_s=recording.arm.t_s + lag_s)))
    return fit.direction_deg if fit is not None and np.isfinite(fit.direction_deg) else np.inf


def shifted_agreement(imu: ImuStream, arm: JointTracks, reach_s: float) -> tuple[float, float, bool]:
    """How well an IMU turns as an arm does, at whatever shift of their clocks.

    Parameters
    ----------
    imu : ImuStream
        Its times may count from anywhere.
    arm : JointTracks
        With elbow and wrist.
    reach_s : float, s
        A shift up to this needs no proof: clocks that far apart count as near.

    Returns
    -------
    correlation : float
        Of the two speeds at the best shift; 0 where there is too little to compare.
    shift_s : float, s
        t_imu - t_camera there.
    far : bool
        No shift within reach explains the motion about as well.
    """
    peak = _Peak.of(imu, arm)
    if peak is None:
        return 0.0, 0.0, False
    within = np.abs(peak.lags_s) <= reach_s
    near = float(peak.score[within].max(initial=-np.inf))
    return peak.correlation, peak.lag_s, bool(near < RIVAL * peak.score.max())


@dataclass(frozen=True)
class _Peak:
    """The shift at which two speeds agree best.

    Attributes
    ----------
    lag_s, correlation : t_imu - t_camera, and Pearson's correlation there.
    lags_s, score : all shifts, and how unlikely their correlations are to be chance.
    """

    lag_s: float
    correlation: float
    lags_s: FloatArray
    score: FloatArray

    @classmethod
    def of(cls, imu_stream: ImuStream, arm: JointTracks) -> _Peak | None:
        """None where there is too little of either."""
        camera_t, camera = _camera_speed(arm)
        imu_t, imu = _imu_speed(imu_stream)
        if len(camera) < OVERLAP_S * GRID_HZ or len(imu) < OVERLAP_S * GRID_HZ:
            return None
        r, count = masked_correlation(imu, camera, AT_REST)
        lag = (np.arange(len(r)) - (len(camera) - 1)) / GRID_HZ + imu_t[0] - camera_t[0]
        score = np.arctanh(np.clip(r, -0.999, 0.999)) * np.sqrt(count)
        score[count < OVERLAP_S * GRID_HZ] = -np.inf
        if not np.isfinite(score).any():
            return None
        best = int(np.argmax(score))
        return cls(float(lag[best]), float(r[best]), lag, score)

    def highest_lags_s(self) -> FloatArray:
        """The shifts of the highest peaks, the highest first."""
        score = np.where(np.isfinite(self.score), self.score, 0.0)
        apart = round(PEAK_APART_S * GRID_HZ)
        return self.lags_s[peaks(score, PEAK_SHARE * float(score.max()), apart, PEAKS)]

    @property
    def is_clear(self) -> bool:
        """The speeds agree well, and nowhere else about as well."""
        others = np.abs(self.lags_s - self.lag_s) > PEAK_S
        rival = float(self.score[others].max(initial=-np.inf))
        return self.correlation >= CLEAR and rival < RIVAL * self.score.max()


def _camera_speed(arm: JointTracks) -> tuple[FloatArray, FloatArray]:
    """Grid and angular speed of the elbow-wrist direction, rad/s; nan where the camera saw neither."""
    visible = arm.tracked("elbow") & arm.tracked("wrist")
    along = (arm.joint("wrist") - arm.joint("elbow"))[visible]
    length = np.linalg.norm(along, axis=1)
    t = arm.t_s[visible][length > 0]
    if len(t) < 3:
        return np.empty(0), np.empty(0)
    grid = np.arange(t[0], t[-1], 1 / GRID_HZ)
    direction = along[length > 0] / length[length > 0, None]
    on_grid = np.stack([np.interp(grid, t, axis) for axis in direction.T], axis=1)
    rate = gaussian_smoothed(on_grid, SMOOTH_S * GRID_HZ, derivative=True) * GRID_HZ
    after = np.clip(np.searchsorted(t, grid, side="right"), 1, len(t) - 1)
    missing = t[after] - t[after - 1] > BRIDGED_S
    return grid, np.where(missing, np.nan, np.linalg.norm(rate, axis=1))


def _imu_speed(imu: ImuStream) -> tuple[FloatArray, FloatArray]:
    """Grid and the gyroscope's speed, rad/s, smoothed as the camera's; nan where samples are missing."""
    t = imu.t_s
    if len(t) < 3:
        return np.empty(0), np.empty(0)
    grid = np.arange(t[0], t[-1], 1 / GRID_HZ)
    rate = imu.gyro - np.median(imu.gyro, axis=0)
    on_grid = np.stack([np.interp(grid, t, axis) for axis in rate.T], axis=1)
    after = np.clip(np.searchsorted(t, grid, side="right"), 1, len(t) - 1)
    missing = t[after] - t[after - 1] > BRIDGED_S
    speed = np.linalg.norm(gaussian_smoothed(on_grid, SMOOTH_S * GRID_HZ), axis=1)
    return grid, np.where(missing, np.nan, speed)
