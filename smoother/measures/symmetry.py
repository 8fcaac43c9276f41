"""Left against right: the symmetry index of both arms of one person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..result import Recovery
from ..runtime.pool import Progress
from .definitions import definition_of, interval
from .measure import Measure, Measures, MeasureSettings
from .measuring import SESSION, Measuring

#: Measures with a true zero, whose ratio means something.
COMPARED = (
    "elbow_flexion_range_deg",
    "pronation_range_deg",
    "shoulder_elevation_range_deg",
    "elbow_flexion_peak_speed_deg_s",
    "shoulder_elevation_peak_speed_deg_s",
    "hand_path_length_m",
    "hand_peak_speed_m_s",
    "hand_mean_speed_m_s",
    "hand_reach_hull_l",
    "hand_reach_alpha_l",
    "hand_reach_sphere_percent",
    "movement_count",
    "movement_time_percent",
)


@dataclass(frozen=True)
class BothArms:
    """Both arms of one person, measured and compared.

    Attributes
    ----------
    left, right : Measures
        Of the arms.
    rows : tuple of Measure
        Symmetry indices, `KEY_symmetry_percent`: 0 = alike, positive = the right one has more.
    """

    left: Measures
    right: Measures
    rows: tuple[Measure, ...]

    @property
    def by_key(self) -> dict[str, Measure]:
        """The indices by their key."""
        return {row.key: row for row in self.rows}

    def as_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {key: row.as_dict() for key, row in self.by_key.items()}


def symmetry_index(
    left: FloatArray,  # (n,)
    right: FloatArray,  # (n,)
) -> FloatArray:  # (n,) percent
    """Difference of right and left over their mean, percent; nan where both are zero.

    100 (R - L) / (0.5 (R + L)): Robinson, Herzog, Nigg, J Manipulative Physiol Ther 10:172-176 (1987).
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(100.0 * (right - left) / (0.5 * (right + left)))


def measure_both(recoveries: Sequence[Recovery], settings: MeasureSettings | None = None) -> BothArms:
    """Measure both arms of one person, and compare them.

    The arms' draws are independent of each other: the index is drawn from pairs of them.

    Parameters
    ----------
    recoveries : sequence of Recovery
        One of a left and one of a right arm, of one person.
    settings : MeasureSettings, optional
        As for `measure`.

    Returns
    -------
    both : BothArms
        Measures of both arms, and the indices.

    Raises
    ------
    UnoccludeError
        They are not one left and one right arm of one person.
    """
    by_side = {recovery.side: recovery for recovery in recoveries}
    if len(recoveries) != 2 or by_side.keys() != {"left", "right"} or len({r.body for r in recoveries}) != 1:
        arms = ", ".join(recovery.arm_label for recovery in recoveries) or "none"
        raise UnoccludeError(f"symmetry needs the left and the right arm of one person; there is: {arms}")
    return measure_arms(recoveries, settings or MeasureSettings())[1][0]


def measure_arms(
    recoveries: Sequence[Recovery],
    settings: MeasureSettings,
    processes: int = 1,
    progress: Progress | None = None,
) -> tuple[list[Measures], list[BothArms]]:
    """The measures of each arm, and the comparison of each person's two arms."""
    done: list[Measuring] = []

    def of_all(share: float, text: str) -> None:
        if progress is not None:
            progress((len(done) + share) / len(recoveries), text)

    for recovery in recoveries:
        done.append(Measuring(recovery, settings, processes, of_all))
    by_body: dict[int | None, dict[str, list[Measuring]]] = {}
    for one in done:
        by_body.setdefault(one.recovery.body, {}).setdefault(one.recovery.side, []).append(one)
    pairs = [
        both_arms(sides["left"][0], sides["right"][0])
        for sides in by_body.values()
        if sides.keys() == {"left", "right"} and all(len(arms) == 1 for arms in sides.values())
    ]
    return [one.measures() for one in done], pairs


def both_arms(left: Measuring, right: Measuring) -> BothArms:
    """The same of two arms that are measured already."""
    of_left, of_right = left.measures(), right.measures()
    rows = []
    for key in COMPARED:
        one, other = of_left.by_key.get(key), of_right.by_key.get(key)
        if one is None or other is None or not (one.is_known and other.is_known):
            continue
        value = float(symmetry_index(np.array([one.value]), np.array([other.value]))[0])
        count = min(left.count, right.count)
        drawn = symmetry_index(left.drawn(SESSION, key)[:count], right.drawn(SESSION, key)[:count])
        name = f"{key}_symmetry_percent"
        definition = definition_of(name)
        low, high, sigma = interval(value, drawn, definition)
        note = "" if np.isfinite(value) else "Both arms have none."
        rows.append(
            Measure(
                *(name, definition.name, definition.unit, value, low, high, sigma),
                recovered_share=0.5 * (one.recovered_share + other.recovered_share),
                scope="session",
                movement=None,
                start_s=min(one.start_s, other.start_s),
                end_s=max(one.end_s, other.end_s),
                n_draws=count if np.isfinite(low) else 0,
                note=note,
                untrusted_share=0.5 * (one.untrusted_share + other.untrusted_share),
            )
        )
    return BothArms(of_left, of_right, tuple(rows))
