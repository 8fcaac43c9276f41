"""Measures made by hand, and rows of a study that hold them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from smoother.evaluation.progress import PersonProgress
from smoother.measures import Measure, Measures, Movement
from smoother.measures.definitions import definition_of
from smoother.study.folder import COLUMNS, StudyFolder, measure_rows, schema
from smoother.study.inputs import SessionEntry
from smoother.study.progress import progress_of

#: A sound arm, and the standard deviation with which each measure is known.
ARM: dict[str, tuple[float, float]] = {
    "elbow_flexion_range_deg": (98.0, 2.0),
    "elbow_flexion_min_deg": (14.0, 1.5),
    "elbow_flexion_max_deg": (112.0, 1.5),
    "shoulder_elevation_range_deg": (80.0, 2.0),
    "shoulder_elevation_min_deg": (8.0, 1.2),
    "shoulder_elevation_max_deg": (88.0, 1.8),
    "pronation_range_deg": (70.0, 4.0),
    "pronation_min_deg": (-10.0, 3.0),
    "pronation_max_deg": (60.0, 3.0),
    "hand_reach_hull_l": (52.0, 3.0),
    "hand_peak_speed_m_s": (1.1, 0.04),
    "hand_mean_speed_m_s": (0.4, 0.01),
    "hand_path_length_m": (24.0, 0.2),
    "hand_path_ratio": (1.3, 0.05),
    "sparc": (-1.7, 0.06),
    "ldlj_v": (-6.5, 0.2),
    "movement_duration_s": (1.4, 0.05),
    "hand_to_mouth_distance_m": (0.0, 0.01),
    "elbow_flexion_zone_10_to_20_percent": (12.0, 1.0),
    "elbow_flexion_zone_20_to_30_percent": (35.0, 1.5),
    "elbow_flexion_zone_40_to_50_percent": (53.0, 1.5),
}
REACHED = {"hand_to_mouth_reached": 1.0, "hand_to_head_reached": 0.0, "hand_behind_back_reached": 0.0}


def made_measure(key: str, value: float, sigma: float, **more: Any) -> Measure:
    """A measure with a normal interval."""
    definition = definition_of(key)
    usual = {"recovered_share": 0.2, "scope": "session", "movement": None, "start_s": 0.0, "end_s": 60.0}
    draws = 64 if math.isfinite(sigma) else 0
    low, high = value - 1.96 * sigma, value + 1.96 * sigma
    return Measure(
        key, definition.name, definition.unit, value, low, high, sigma, n_draws=draws, **(usual | more)
    )


def made_measures(
    side: str = "right",
    *,
    rng: np.random.Generator | None = None,
    change: Mapping[str, float] | None = None,
    movements: int = 6,
    draws: bool = True,
    **more: Any,
) -> Measures:
    """Measures of an arm; with random numbers each value is off by an error of its sigma."""

    def error(sigma: float) -> float:
        return 0.0 if rng is None else float(rng.normal(0.0, sigma))

    rows = [
        made_measure(key, value + (change or {}).get(key, 0.0) + error(sigma), sigma if draws else math.nan)
        for key, (value, sigma) in ARM.items()
    ]
    certain = REACHED | {"movement_count": 6.0}
    rows += [made_measure(key, value, 0.0 if draws else math.nan) for key, value in certain.items()]
    places = tuple(Movement(10.0 * n, 10.0 * n + 2.0, "movement") for n in range(movements))
    for number in range(movements):
        wave = math.sin(number)
        for key, value, sigma in (
            ("hand_peak_speed_m_s", 1 + 0.1 * wave, 0.04),
            ("sparc", -1.6 - 0.1 * wave, 0.05),
        ):
            rows.append(
                made_measure(key, value, sigma if draws else math.nan, scope="movement", movement=number)
            )
    about = {"trusted": True, "verdict": "To be trusted.", "n_draws": 64 if draws else 0} | more
    about = {"name": "reach", "body": None, "start_s": 0.0, "end_s": 60.0} | about
    return Measures(side=side, rows=tuple(rows), movements=places, **about)


def study_row(name: str, measured: Sequence[Measures] | None, **more: Any) -> dict[str, Any]:
    """A row of a study's results."""
    empty: dict[str, Any] = {column: None for column, *_ in COLUMNS}
    return empty | {
        "id": name,
        "recording": name,
        "status": "done",
        "config_hash": "c",
        "calibration_hash": "",
        "version": "1",
        "finished": datetime(2026, 1, 1),
        "trusted": True,
        "measures": None if measured is None else measure_rows(measured),
        **more,
    }


def write_study(path: Path, rows: Sequence[dict[str, Any]]) -> Path:
    """A study's folder that holds these rows."""
    import pyarrow as pa
    from pyarrow import parquet

    StudyFolder(path).open()
    parquet.write_table(
        pa.Table.from_pylist(list(rows), schema=schema()), path / "results" / "rows-1.parquet"
    )
    return path


def person(
    sessions: int = 4, arms: Sequence[str] = ("right",), name: str = "p12", draws: bool = True
) -> PersonProgress:
    """A person whose elbow bends more every time."""
    rng = np.random.default_rng(0)
    attended = {
        f"{name}/s{n}.mcap": SessionEntry(f"{name}/s{n}.mcap", name, f"s{n}", "", 14.0 * n)
        for n in range(sessions)
    }
    rows = []
    for n, path in enumerate(attended):
        more = {"rng": rng, "draws": draws, "change": {"elbow_flexion_range_deg": 10.0 * n}}
        rows.append(study_row(path, [made_measures(side, **more) for side in arms]))
    (progress,) = progress_of(rows, attended)
    return progress
