"""What a table of any layout seems to hold."""

from __future__ import annotations

from .guess import Guess
from .guess_sensor import guess_sensor
from .guess_skeleton import guess_skeleton
from .joint_columns import find_joint_columns
from .sheet import Sheet


def guess_of(sheet: Sheet) -> Guess:
    """Guess what a table holds.

    Parameters
    ----------
    sheet : Sheet
        The table.

    Returns
    -------
    Guess
        Of `kind` "" where it is neither an IMU's nor a skeleton's.
    """
    joints = find_joint_columns(sheet.layout.names) if sheet.layout.names else None
    if joints is not None and joints.has_arm():
        return guess_skeleton(sheet, joints)
    return guess_sensor(sheet)
