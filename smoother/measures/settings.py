"""Settings of the measures: few leaves, each with its unit and its reason; `measures --config M.toml`."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class _Leaves(BaseModel):
    """A group of settings; unknown names are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Smoothing(_Leaves):
    """The low-pass filter that answer, draws and truth all go through before anything is measured."""

    cutoff_hz: float = Field(
        default=6.0, ge=1, le=20, description="second-order Butterworth, run forth and back, Hz"
    )
    most_rate_hz: float = Field(
        default=100.0, ge=40, le=1000, description="faster recordings are measured at this rate, Hz"
    )


class SegmentingMovements(_Leaves):
    """When the hand moves: thresholds of its speed."""

    start_m_s: float = Field(default=0.10, gt=0, description="a movement gets at least this fast, m/s")
    rest_m_s: float = Field(default=0.03, gt=0, description="it starts and ends where it is slower, m/s")
    rest_share: float = Field(default=0.05, gt=0, lt=1, description="or slower than this part of its peak")
    shortest_s: float = Field(default=0.30, gt=0, description="shorter ones do not count, s")
    peak_rise_m_s: float = Field(
        default=0.02, gt=0, description="a velocity peak rises this far above the minimum before it, m/s"
    )
    peak_apart_s: float = Field(default=0.15, gt=0, description="velocity peaks are this far apart, s")


class MatchingRepetitions(_Leaves):
    """Rounds of an exercise: matched to the first one."""

    start_s: float | None = Field(default=None, description="where a round begins, s; looked for if left out")
    end_s: float | None = Field(default=None, description="where it ends, s; looked for if left out")
    shortest_s: float = Field(default=2.0, gt=0.5, description="shorter rounds are not looked for, s")
    longest_s: float = Field(default=60.0, gt=1, description="nor longer ones, s")
    likeness: float = Field(
        default=0.35,
        gt=0,
        le=1,
        description="mean distance from the matched round, in standard deviations of the motion, at most",
    )


class Reach(_Leaves):
    """The reach volume, and the zones about the trunk."""

    voxel_m: float = Field(
        default=0.01, gt=0.002, le=0.2, description="one place of the hand in a cube of this size, m"
    )
    alpha_m: float = Field(
        default=0.30, gt=0.01, description="alpha shape: places this far apart do not belong together, m"
    )
    mouth_m: float = Field(default=0.15, gt=0, description="hand-to-mouth: nearer to the mouth than this, m")
    head_m: float = Field(default=0.10, gt=0, description="hand-to-head: nearer to the head's surface, m")
    behind_m: float = Field(default=0.02, description="hand-behind-back: this far behind the shoulders, m")


class MeasureSettings(_Leaves):
    """Everything that can be set of `unocclude measures`."""

    smoothing: Smoothing = Smoothing()
    movements: SegmentingMovements = SegmentingMovements()
    repetitions: MatchingRepetitions = MatchingRepetitions()
    reach: Reach = Reach()
