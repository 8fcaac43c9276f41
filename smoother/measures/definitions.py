"""What every measure is called, its unit, the values that it can take, and its interval."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..array_types import FloatArray
from .angles import PERCENTILES
from .motion import MEASURED_ANGLES

INFINITE = float("inf")
#: Names of the angles for people.
ANGLE_WORDS = {
    "elbow_flexion": "elbow flexion",
    "pronation": "forearm pronation",
    "shoulder_elevation": "shoulder elevation",
    "shoulder_plane": "plane of shoulder elevation",
    "shoulder_rotation": "shoulder rotation",
    "shoulder_elevation_trunk": "shoulder elevation against the trunk",
    "shoulder_plane_trunk": "plane of shoulder elevation against the trunk",
    "shoulder_rotation_trunk": "shoulder rotation against the trunk",
}

#: Angles between two directions: from 0 to 180 degrees.
UNSIGNED = ("elbow_flexion", "shoulder_elevation", "shoulder_elevation_trunk")


@dataclass(frozen=True)
class MeasureDefinition:
    """What a measure is."""

    name: str  # In plain words
    unit: str  # "" for a pure number
    low: float = -INFINITE  # Values beyond these do not exist; an interval ends there
    high: float = INFINITE  # Values beyond these do not exist; an interval ends there
    is_count: bool = False  # Whole numbers only


_OF_HAND = {
    "hand_path_length_m": MeasureDefinition("path length of the hand", "m", 0.0),
    "hand_path_ratio": MeasureDefinition("path ratio of the hand (1 = straight)", "", 1.0),
    "hand_peak_speed_m_s": MeasureDefinition("peak speed of the hand", "m/s", 0.0),
    "hand_mean_speed_m_s": MeasureDefinition("mean speed of the hand", "m/s", 0.0),
    "hand_time_to_peak_s": MeasureDefinition("time to peak speed", "s", 0.0),
    "hand_time_to_peak_percent": MeasureDefinition("time to peak speed, of the movement", "%", 0.0, 100.0),
    "hand_reach_hull_l": MeasureDefinition("reach volume, convex hull", "l", 0.0),
    "hand_reach_alpha_l": MeasureDefinition("reach volume, alpha shape", "l", 0.0),
    "hand_reach_sphere_percent": MeasureDefinition(
        "reach volume, of the sphere about the shoulder", "%", 0.0, 100.0
    ),
    "hand_to_mouth_reached": MeasureDefinition("hand to mouth reached", "", 0.0, 1.0, True),
    "hand_to_mouth_distance_m": MeasureDefinition("nearest to the mouth's zone", "m", 0.0),
    "hand_to_head_reached": MeasureDefinition("hand to head reached", "", 0.0, 1.0, True),
    "hand_to_head_distance_m": MeasureDefinition("nearest to the head's zone", "m", 0.0),
    "hand_behind_back_reached": MeasureDefinition("hand behind back reached", "", 0.0, 1.0, True),
    "hand_behind_back_distance_m": MeasureDefinition("nearest to the zone behind the back", "m", 0.0),
    "elbow_trunk_distance_max_m": MeasureDefinition("largest distance of the elbow from the trunk", "m", 0.0),
    "elbow_trunk_distance_mean_m": MeasureDefinition("mean distance of the elbow from the trunk", "m", 0.0),
    "sparc": MeasureDefinition("smoothness, spectral arc length (SPARC)", "", high=0.0),
    "ldlj_v": MeasureDefinition("smoothness, log dimensionless jerk (LDLJ-V)", ""),
    "velocity_peaks": MeasureDefinition("velocity peaks in a movement", "", 0.0, is_count=True),
    "duration_s": MeasureDefinition("duration", "s", 0.0),
    "movement_count": MeasureDefinition("movements", "", 0.0, is_count=True),
    "movement_time_percent": MeasureDefinition("time in movement", "%", 0.0, 100.0),
    "movement_duration_s": MeasureDefinition("duration of a movement, mean", "s", 0.0),
    "repetition_count": MeasureDefinition("repetitions", "", 0.0, is_count=True),
    "repetition_duration_s": MeasureDefinition("duration of a repetition, mean", "s", 0.0),
    "repetition_duration_cv_percent": MeasureDefinition("variation of the repetitions' duration", "%", 0.0),
}


@cache
def definitions() -> dict[str, MeasureDefinition]:
    """Every measure by its key, but for the zones of angles."""
    by_key: dict[str, MeasureDefinition] = {}
    for angle in MEASURED_ANGLES:
        words = ANGLE_WORDS[angle]
        ends = (0.0, 180.0) if angle in UNSIGNED else (-INFINITE, INFINITE)
        by_key[f"{angle}_range_deg"] = MeasureDefinition(f"{words}, range", "deg", 0.0, 360.0)
        by_key[f"{angle}_min_deg"] = MeasureDefinition(f"{words}, smallest", "deg", *ends)
        by_key[f"{angle}_max_deg"] = MeasureDefinition(f"{words}, largest", "deg", *ends)
        for percentile in PERCENTILES:
            which = "median" if percentile == 50 else f"{percentile}th percentile"
            by_key[f"{angle}_p{percentile}_deg"] = MeasureDefinition(f"{words}, {which}", "deg", *ends)
        by_key[f"{angle}_peak_speed_deg_s"] = MeasureDefinition(f"{words}, peak speed", "deg/s", 0.0)
    return by_key | _OF_HAND


def definition_of(key: str) -> MeasureDefinition:
    """The definition of a measure, zones of angles and symmetry included."""
    if key in definitions():
        return definitions()[key]
    if key.endswith("_symmetry_percent"):
        of = definitions()[key.removesuffix("_symmetry_percent")]
        return MeasureDefinition(f"symmetry of {of.name}", "%", -200.0, 200.0)
    angle, _, zone = key.removesuffix("_percent").partition("_zone_")
    low, high = zone.split("_to_")
    return MeasureDefinition(f"{ANGLE_WORDS[angle]}, time from {low} to {high} degrees", "%", 0.0, 100.0)


def is_measure(key: str) -> bool:
    """Whether a measure has this key."""
    if key in definitions() or key.removesuffix("_symmetry_percent") in definitions():
        return True
    angle, _, zone = key.partition("_zone_")
    return angle in MEASURED_ANGLES and bool(re.fullmatch(r"-?\d+_to_-?\d+_percent", zone))


def zone_key(angle: str, low_deg: int, width_deg: int) -> str:
    """Key of a zone of an angle: "elbow_flexion_zone_30_to_40_percent"."""
    return f"{angle}_zone_{low_deg}_to_{low_deg + width_deg}_percent"


#: Fewer draws than this do not show the ends of a 95 % interval.
FEWEST_DRAWS = 20
LEVEL = 0.95


# Drawn motions show how far a measure may be off, not on which side. Noise makes a path longer and an
# extreme more extreme; a drawn motion is the answer and an error on top, rougher than the error in the
# answer, which is the smoothest motion that fits. So draws lie to one side of the answer, and by more than
# the answer lies off the truth (on simulated arms, docs/measures.md). Quantiles of the draws as they are
# then miss the truth, and the basic bootstrap's, mirrored about the answer (Davison, Hinkley, Bootstrap
# Methods and their Application, 1997, section 5.2), overshoot to the other side. The spread of the draws
# about their own median is therefore laid about the answer's value; where draws are at the end of the
# values that exist, so is the interval. Whole numbers (counts, reached or not) do not shift: their
# quantiles count. Means over the movements that each motion finds do both: they shift with the noise in
# every movement and jump with a movement more or less, or two that are one. The interval spans both; either
# alone misses the truth in up to 3 of 10 sessions of a kind. The jumps are rare, so the quantiles are those
# beyond which 2.5 % of further draws lie (Weibull's ranks), not of these draws alone: 3 of 10 became 1.
def interval(
    value: float,
    drawn: FloatArray,
    definition: MeasureDefinition,
    is_found: bool = False,  # drawn (n,)
) -> tuple[float, float, float]:
    """Ends of the 95 % interval about a value, and its standard deviation."""
    drawn = drawn[np.isfinite(drawn)]
    if not np.isfinite(value) or len(drawn) < FEWEST_DRAWS:
        return float("nan"), float("nan"), float("nan")
    levels = [0.5 - 0.5 * LEVEL, 0.5, 0.5 + 0.5 * LEVEL]
    if definition.is_count and not is_found:
        low, _, high = np.quantile(drawn, levels, method="inverted_cdf")
        low, high = min(low, value), max(high, value)
    else:
        least, middle, most = np.quantile(drawn, levels, method="weibull" if is_found else "linear")
        low = definition.low if least <= definition.low else least + value - middle
        high = definition.high if most >= definition.high else most + value - middle
        if is_found:
            low, high = min(low, least), max(high, most)
    low, high = np.clip([low, high], definition.low, definition.high)
    return float(low), float(high), float(drawn.std(ddof=1))
