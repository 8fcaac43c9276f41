"""What `unocclude compare` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .output import centimetres, percent, print_table, say

if TYPE_CHECKING:
    from ..evaluation.compare import Comparison, MethodResult


def print_comparison(comparison: Comparison) -> None:
    """Print the tables of a comparison."""
    what = "forearm IMU" if comparison.point == "sensor" else comparison.point
    columns = (
        "method",
        "rms, cm",
        "95 %",
        "max",
        "rms, deg",
        "NEES",
        "inside 95 %",
        "visible rms, cm",
        "deg",
    )
    title = f"Error of the {what} {comparison.where}, the best method first"
    print_table(comparison.title(title), columns, [_row(comparison, row) for row in comparison.rows])
    _print_joints(comparison)
    _print_lag(comparison)


def _row(comparison: Comparison, row: MethodResult) -> tuple[object, ...]:
    hidden, visible = comparison.figures(row, comparison.part), comparison.figures(row, "visible")
    if hidden is None or visible is None:
        return (row.method, *["-"] * 8)
    return (
        row.method,
        centimetres(hidden.position_rms_m),
        centimetres(hidden.position_p95_m),
        centimetres(hidden.position_max_m),
        hidden.orientation_rms_deg,
        hidden.nees,
        percent(hidden.coverage_95),
        centimetres(visible.position_rms_m),
        visible.orientation_rms_deg,
    )


def _print_joints(comparison: Comparison) -> None:
    answered = [row for row in comparison.rows if row.validation is not None]
    joints = list(dict.fromkeys(joint for row in answered for joint in row.validation.points))  # type: ignore[union-attr]
    if not joints:
        return
    rows = []
    for row in answered:
        assert row.validation is not None
        cells = [row.validation.points.get(joint, {}).get(comparison.part) for joint in joints]
        rows.append(
            (row.method, *[centimetres(None if each is None else each.position_rms_m) for each in cells])
        )
    print_table(comparison.title(f"Joints {comparison.where}, rms, cm"), ("method", *joints), rows)


def _print_lag(comparison: Comparison) -> None:
    say(comparison.camera_words)
    rows = [(row.method, _ms(row.lag_s), _ms(row.lag_occluded_s)) for row in comparison.rows]
    title = "Lag left behind the truth, ms (peak of cross-correlation; - where an answer does not follow it)"
    print_table(comparison.title(title), ("method", "all samples", "in gaps"), rows)


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:+.1f}"
