"""How a recovery shows itself: some lines of text, a table, a picture, a page in a notebook."""

from __future__ import annotations

from html import escape
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from .recording import median_rate_hz
from .sketch import Line, about_median, even_rows, lines_svg, table_html

if TYPE_CHECKING:
    import pyarrow

    from .measurements.visibility import Gap
    from .result import Recovery

#: More gaps than this make a page that nobody reads.
MOST_GAPS = 20
_VERDICT_LENGTH = 200
#: Units of the columns, by the beginning or the end of their name; metres otherwise.
_UNITS = (("t_s", "s"), ("occluded", ""), ("velocity", "m/s"), ("sigma_deg", "deg"))


def recovery_text(recovery: Recovery) -> str:
    """Some lines: whose arm, how long, how many gaps and how sure, the joints, the verdict."""
    gaps, t_s = recovery.gaps, recovery.t_s
    side = f", {recovery.side} arm" if recovery.side else ""
    length_s = float(t_s[-1] - t_s[0]) if len(t_s) else 0.0
    lines = [
        f"Recovery of {recovery.name} by {recovery.method}{side}: {length_s:.1f} s, {len(recovery)} samples"
        f" at {median_rate_hz(t_s):.1f} Hz"
    ]
    if gaps:
        largest = [sigma for sigma in (_largest_sigma_m(recovery, gap) for gap in gaps) if sigma is not None]
        known = f"; largest sigma {100 * max(largest):.1f} cm" if largest else "; no answer in them"
        lengths_s = [gap.length_s for gap in gaps]
        lines.append(
            f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''}, {sum(lengths_s):.1f} s occluded,"
            f" the longest {max(lengths_s):.1f} s{known}"
        )
    else:
        lines.append("no gaps")
    lines.append(f"joints {', '.join(recovery.joints) or 'none'}")
    if recovery.estimates.verdict:
        lines.append(shorten(recovery.estimates.verdict, _VERDICT_LENGTH, placeholder=" .."))
    return "\n  ".join(lines)


def recovery_html(recovery: Recovery) -> str:
    """The same as a page in a notebook, with a table of the gaps and a picture of the motion."""
    first, *others = recovery_text(recovery).split("\n")
    rows = [
        (
            f"{gap.start_s:.2f}",
            f"{gap.length_s:.2f}",
            "no answer" if (sigma := _largest_sigma_m(recovery, gap)) is None else f"{100 * sigma:.1f}",
            "one side" if gap.open_start or gap.open_end else "both sides",
        )
        for gap in recovery.gaps[:MOST_GAPS]
    ]
    table = table_html(("gap from, s", "length, s", "largest sigma, cm", "seen from"), rows) if rows else ""
    more = len(recovery.gaps) - len(rows)
    return (
        f"<p><b>{escape(first)}</b><br>{'<br>'.join(escape(line.strip()) for line in others)}</p>"
        f"{_picture(recovery)}{table}{f'<p>.. and {more} gaps more</p>' if more else ''}"
    )


def recovery_table(recovery: Recovery) -> pyarrow.Table:
    """The columns of `to_arrays`, one a number, as an Arrow table; null where there is no answer."""
    import pyarrow as pa

    columns = flat_columns(recovery)
    arrays = [pa.array(np.ascontiguousarray(values), from_pandas=True) for values in columns.values()]
    fields = [
        pa.field(name, array.type, metadata={"unit": _unit(name)})
        for name, array in zip(columns, arrays, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def flat_columns(recovery: Recovery) -> dict[str, np.ndarray]:
    """The arrays of `to_arrays`, one a number: `wrist_x`, `imu_qw` .."""
    columns = {}
    for name, values in recovery.to_arrays().items():
        if values.ndim == 1:
            columns[name] = values
            continue
        axes = ("qw", "qx", "qy", "qz") if values.shape[1] == 4 else ("x", "y", "z")
        stem = name.removesuffix("_quaternion")
        columns |= {f"{stem}_{axis}": values[:, k] for k, axis in enumerate(axes)}
    return columns


def _unit(name: str) -> str:
    if name.endswith(("_qw", "_qx", "_qy", "_qz")):
        return ""
    return next((unit for key, unit in _UNITS if key in name), "m")


def _largest_sigma_m(recovery: Recovery, gap: Gap) -> float | None:
    """The largest standard deviation of the IMU's position in a gap, m; None where there is no answer."""
    inside = slice(*np.searchsorted(recovery.t_s, [gap.start_s, gap.end_s]).tolist())
    sigma = recovery.rows(inside).worst_sigma_m
    return float(np.nanmax(sigma)) if np.isfinite(sigma).any() else None


def _picture(recovery: Recovery) -> str:
    """Position of the wrist, or of the IMU where there is none, with bands of two sigmas."""
    some = recovery.rows(even_rows(len(recovery)))
    wrist = "wrist" in some.joints
    position = some.joints["wrist"] if wrist else some.position
    spread = some.joint_covariance["wrist"] if wrist else some.pose_covariance[:, :3, :3]
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.einsum("nii->ni", spread))
    lines = [Line(name, about_median(position[:, k]), sigma[:, k]) for k, name in enumerate("xyz")]
    what = f"{'wrist' if wrist else 'IMU'}, m from its median, the camera's axes, +- 2 sigma; gaps shaded"
    return lines_svg(some.t_s, lines, [(gap.start_s, gap.end_s) for gap in recovery.gaps], what)
