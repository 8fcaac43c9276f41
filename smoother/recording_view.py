"""How a recording shows itself: some lines of text, and a page in a notebook."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from .linalg import runs
from .recording import FOREARM_JOINTS, JOINTS, JointState
from .sketch import Line, about_median, even_rows, lines_svg

if TYPE_CHECKING:
    from .recording import BoolArray, Recording


def recording_text(recording: Recording) -> str:
    """Some lines: whose arm, how long, the streams, the joints, what else there is."""
    imu, arm = recording.imu, recording.arm
    length_s = float(imu.t_s[-1] - imu.t_s[0]) if len(imu) else 0.0
    side = f", {recording.side} arm" if recording.side else ""
    share = 100 * forearm_tracked(recording).mean() if len(arm) else 0.0
    more = {
        "a magnetometer": imu.mag is not None,
        "an IMU on the upper arm": recording.upper_imu is not None,
        "one on the trunk": recording.trunk is not None,
        "an IMU on the camera": recording.base_imu is not None,
        "truth": recording.truth is not None,
    }
    lines = [
        f"Recording {recording.name}{side}: {length_s:.1f} s",
        f"IMU {imu.name}: {len(imu)} samples at {imu.rate_hz:.1f} Hz",
        f"camera {arm.name}: {len(arm)} frames at {arm.rate_hz:.1f} Hz, forearm tracked in {share:.0f} %",
        f"joints {', '.join(arm.present) or 'none'}",
    ]
    if any(more.values()):
        lines.append(f"with {', '.join(name for name, is_there in more.items() if is_there)}")
    return "\n  ".join(lines)


def recording_html(recording: Recording) -> str:
    """The same as a page in a notebook, with a picture of what the camera saw."""
    first, *others = recording_text(recording).split("\n")
    arm = recording.arm
    rows = even_rows(len(arm))
    some = arm.select(rows)
    joint = next((name for name in ("wrist", "hand", "strap", "elbow") if name in arm.present), None)
    picture = ""
    if joint is not None:
        position = np.where(some.tracked(joint)[:, None], some.joint(joint), np.nan)
        lines = [Line(axis, about_median(position[:, k])) for k, axis in enumerate("xyz")]
        hidden = [(arm.t_s[run.start], arm.t_s[run.stop - 1]) for run in runs(~forearm_tracked(recording))]
        caption = f"{joint} as tracked, m from its median, the camera's axes; forearm not tracked: shaded"
        picture = lines_svg(some.t_s, lines, hidden, caption)
    return f"<p><b>{escape(first)}</b><br>{'<br>'.join(escape(line.strip()) for line in others)}</p>{picture}"


def forearm_tracked(recording: Recording) -> BoolArray:
    """(F,) frames in which the camera tracked a joint of the forearm."""
    columns = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    return np.asarray((recording.arm.state[:, columns] == JointState.TRACKED).any(axis=1))
