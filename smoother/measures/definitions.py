"""All measures: names, units, possible values, scope, and intervals."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import numpy as np

from ..angles.definitions import (
    ANGLE_TITLES,
    ELBOW_FLEXION,
    PRONATION,
    SHOULDER_ELEVATION,
    SHOULDER_PLANE,
    SHOULDER_ROTATION,
)
from ..array_types import FloatArray
from .measure import Scope

INFINITE = float("inf")
#: The angles that are measured, in the order of the tables.
_OF_ARM = (ELBOW_FLEXION, PRONATION, SHOULDER_ELEVATION, SHOULDER_PLANE, SHOULDER_ROTATION)
_OF_TRUNK = (SHOULDER_ELEVATION.to_trunk, SHOULDER_PLANE.to_trunk, SHOULDER_ROTATION.to_trunk)
MEASURED_ANGLES = tuple(angle.name for angle in (*_OF_ARM, *_OF_TRUNK))
#: Angles between two directions: from 0 to 180 degrees.
UNSIGNED = ("elbow_flexion", "shoulder_elevation", "shoulder_elevation_trunk")
PERCENTILES = (5, 50, 95)
ALL: tuple[Scope, ...] = ("session", "movement", "repetition")
LONG: tuple[Scope, ...] = ("session", "repetition")


@dataclass(frozen=True)
class MeasureDefinition:
    """What a measure is."""

    name: str  # In plain words
    unit: str  # "" for a pure number
    low: float = -INFINITE  # Values beyond these do not exist; an interval ends there
    high: float = INFINITE
    is_count: bool = False  # Whole numbers only
    scopes: tuple[Scope, ...] = ALL  # What it is measured of
    # Of a longer time it is this of those of the movements that a motion finds in itself
    over_movements: Literal["", "mean", "median"] = ""
    is_found: bool = False  # It depends on which movements or repetitions a motion finds in itself
    why_not: str = "There is no movement of the hand to measure."  # Where it has no value
    angle: str = ""  # Of which angle it is


#: Of a longer time as a whole; of a session; of a longer time what it is of its movements on average.
_long = partial(MeasureDefinition, scopes=LONG)
_session = partial(MeasureDefinition, scopes=("session",))
_mean = partial(MeasureDefinition, over_movements="mean", is_found=True)
_NO_VOLUME = "The hand's positions have no volume."
_NO_ARM = "Needs the arm's length: shoulder, elbow and wrist."
_NO_ENDS = "No movement ends more than 5 cm from where it began."
_NO_TRUNK = "Needs shoulder, elbow and wrist, and the direction of gravity."
_FEW_ROUNDS = "Too few repetitions."
_OF_HAND = {
    "hand_path_length_m": MeasureDefinition("path length of the hand", "m", 0.0),
    "hand_peak_speed_m_s": MeasureDefinition("peak speed of the hand", "m/s", 0.0),
    "hand_mean_speed_m_s": MeasureDefinition("mean speed of the hand", "m/s", 0.0),
    "hand_reach_hull_l": _long("reach volume, convex hull", "l", 0.0, why_not=_NO_VOLUME),
    "hand_reach_alpha_l": _long("reach volume, alpha shape", "l", 0.0, why_not=_NO_VOLUME),
    "hand_reach_sphere_percent": _long(
        "reach volume, of the sphere about the shoulder", "%", 0.0, 100.0, why_not=_NO_ARM
    ),
    "hand_to_mouth_reached": _long("hand to mouth reached", "", 0.0, 1.0, True, why_not=_NO_TRUNK),
    "hand_to_mouth_distance_m": _long("nearest to the mouth's zone", "m", 0.0, why_not=_NO_TRUNK),
    "hand_to_head_reached": _long("hand to head reached", "", 0.0, 1.0, True, why_not=_NO_TRUNK),
    "hand_to_head_distance_m": _long("nearest to the head's zone", "m", 0.0, why_not=_NO_TRUNK),
    "hand_behind_back_reached": _long("hand behind back reached", "", 0.0, 1.0, True, why_not=_NO_TRUNK),
    "hand_behind_back_distance_m": _long("nearest to the zone behind the back", "m", 0.0, why_not=_NO_TRUNK),
    "elbow_trunk_distance_max_m": _long(
        "largest distance of the elbow from the trunk", "m", 0.0, why_not=_NO_TRUNK
    ),
    "elbow_trunk_distance_mean_m": _long(
        "mean distance of the elbow from the trunk", "m", 0.0, why_not=_NO_TRUNK
    ),
    "sparc": _mean("smoothness, spectral arc length (SPARC)", "", high=0.0),
    "ldlj_v": _mean("smoothness, log dimensionless jerk (LDLJ-V)", ""),
    "velocity_peaks": _mean("velocity peaks in a movement", "", 0.0, is_count=True),
    "hand_time_to_peak_s": _mean("time to peak speed", "s", 0.0),
    "hand_time_to_peak_percent": _mean("time to peak speed, of the movement", "%", 0.0, 100.0),
    "hand_path_ratio": _mean(
        "path ratio of the hand (1 = straight)", "", 1.0, over_movements="median", why_not=_NO_ENDS
    ),
    "duration_s": MeasureDefinition("duration", "s", 0.0, scopes=("movement",)),
    "movement_count": _session("movements", "", 0.0, is_count=True),
    "movement_time_percent": _session("time in movement", "%", 0.0, 100.0, is_found=True),
    "movement_duration_s": _session("duration of a movement, mean", "s", 0.0, is_found=True),
    "repetition_count": _session("repetitions", "", 0.0, is_count=True),
    "repetition_duration_s": _session(
        "duration of a repetition, mean", "s", 0.0, is_found=True, why_not=_FEW_ROUNDS
    ),
    "repetition_duration_cv_percent": _session(
        "variation of the repetitions' duration", "%", 0.0, is_found=True, why_not=_FEW_ROUNDS
    ),
}
#: Those that are means over the movements that a motion finds in itself.
BY_MOVEMENT = (*(key for key, row in _OF_HAND.items() if row.over_movements), "movement_duration_s")


@cache
def definitions() -> dict[str, MeasureDefinition]:
    """Every measure by its key, in the order of tables, but for the zones of angles."""
    by_key: dict[str, MeasureDefinition] = {}
    for angle in MEASURED_ANGLES:
        ends = (0.0, 180.0) if angle in UNSIGNED else (-INFINITE, INFINITE)
        of_angle = {
            "range_deg": ("range", "deg", 0.0, 360.0),
            "min_deg": ("smallest", "deg", *ends),
            "max_deg": ("largest", "deg", *ends),
            **{f"p{each}_deg": (f"{each}th percentile", "deg", *ends) for each in PERCENTILES},
            "p50_deg": ("median", "deg", *ends),
            "peak_speed_deg_s": ("peak speed", "deg/s", 0.0, INFINITE),
        }
        for what, (which, unit, low, high) in of_angle.items():
            row = MeasureDefinition(f"{ANGLE_TITLES[angle]}, {which}", unit, low, high, angle=angle)
            by_key[f"{angle}_{what}"] = row
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
    return MeasureDefinition(f"{ANGLE_TITLES[angle]}, time from {low} to {high} degrees", "%", 0.0, 100.0)


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
