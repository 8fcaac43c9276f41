"""Which of many measures a page or a table begins with."""

from __future__ import annotations

from collections.abc import Collection

#: Those that a reader looks at first, in that order.
FIRST = (
    *("elbow_flexion_range_deg", "shoulder_elevation_max_deg", "hand_reach_hull_l"),
    *("hand_peak_speed_m_s", "sparc", "pronation_range_deg", "elbow_flexion_min_deg"),
    *("shoulder_elevation_range_deg", "movement_duration_s", "hand_path_ratio"),
)
#: Those that grow with the length of the recording, whatever the person does.
OF_LENGTH = ("duration_s", "hand_path_length_m", "movement_count", "repetition_count")
#: Those that are means over the movements of a session, or of one of them.
BY_MOVEMENT = (
    *("sparc", "ldlj_v", "velocity_peaks", "hand_path_ratio", "movement_duration_s"),
    *("hand_time_to_peak_s", "hand_time_to_peak_percent"),
)
#: Details of an angle's distribution: in files, not on pages.
_DETAILS = ("_zone_", "_p5_", "_p25_", "_p50_", "_p75_", "_p95_")


def is_main(key: str) -> bool:
    """Whether a table for people shows this measure: no detail, and not one of the recording's length."""
    return key not in OF_LENGTH and not any(detail in key for detail in _DETAILS)


def first_of(keys: Collection[str], most: int) -> list[str]:
    """The keys to look at first, at most so many; in their order."""
    ordered = [key for key in FIRST if key in keys]
    ordered += [key for key in dict.fromkeys(keys) if is_main(key) and key not in ordered]
    return ordered[:most]
