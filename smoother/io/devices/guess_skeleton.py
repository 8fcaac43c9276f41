"""A guess at which columns of a table are a skeleton's joints."""

from __future__ import annotations

import numpy as np

from .arm_lengths import unit_by_arm
from .guess import Guess, named
from .guess_units import time_unit
from .joint_columns import JointColumns
from .sheet import Sheet


def guess_skeleton(sheet: Sheet, joints: JointColumns) -> Guess:
    """Guess at a table with a row a frame, whose joints are known by their names."""
    axes, states, time = joints.axes, joints.confidence, joints.time
    guess = Guess("skeleton")
    for joint, columns in axes.items():
        guess.columns[joint] = [named(sheet, column) for column in columns]
        if joint in states:
            guess.columns[f"{joint}_state"] = named(sheet, states[joint])
    guess.reasons["columns"] = "names of joints"
    if states:
        cells = sorted({cell for column in states.values() for cell in set(sheet.texts(column))})[:4]
        words = dict(zip(cells, ("not_tracked", "inferred", "tracked", "tracked"), strict=False))
        guess.keys["states"] = words
        guess.reasons["states"] = "NOT KNOWN: the order of the values that occur"
        guess.unsure.append("states: what the values of the confidence mean stands in the program's manual.")
    unit = unit_by_arm({joint: sheet.vectors(columns) for joint, columns in axes.items()})
    guess.keys["position_unit"] = unit[0] if unit else "m"
    guess.reasons["position_unit"] = "arms have an arm's length so" if unit else "NOT KNOWN: no unit fits"
    scale, why = ("", "") if time is None else time_unit(sheet, time)
    if time is not None and scale:
        guess.columns["t"] = named(sheet, time)
        guess.keys["time_unit"], guess.reasons["time_unit"] = scale, why
    else:
        guess.keys["rate_hz"] = 30.0
        guess.reasons["rate_hz"] = "NOT KNOWN: the file has no times"
        guess.unsure.append("rate_hz is made up: write the camera's frames a second.")
    down, why = _down(sheet, axes)
    guess.keys["frame"] = down
    guess.reasons["frame"] = why
    guess.unsure.append("frame: which way the axes point; `smooth` says so where gravity is found elsewhere.")
    return guess


def _down(sheet: Sheet, axes: dict[str, tuple[int, int, int]]) -> tuple[str, str]:
    """The camera's frame in which wrists and elbows hang below shoulders most of the time."""
    downs = {"kinect": (1, -1), "optical": (1, 1), "zup": (2, -1)}
    score = dict.fromkeys(downs, 0.0)
    for side in ("left", "right"):
        if {f"shoulder_{side}", f"elbow_{side}"} <= axes.keys():
            arm = sheet.vectors(axes[f"elbow_{side}"]) - sheet.vectors(axes[f"shoulder_{side}"])
            for name, (axis, sign) in downs.items():
                score[name] += float(np.nansum(sign * arm[:, axis]))
    best = max(score, key=lambda name: score[name])
    return best, "upper arms hang down so" if score[best] > 0 else "NOT KNOWN"
