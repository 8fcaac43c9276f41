"""A vector of a table that lacks one of its three columns, and the name that this column would have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from .channel_names import kind_of
from .head import shown
from .joint_names import words_of

#: The letter of an axis in a column's name: between signs, a capital behind a word, or the last letter.
_AXIS = re.compile(r"(?<![A-Za-z])[xyzXYZ](?![A-Za-z])|(?<=[a-z])[XYZ](?![a-z])|(?<=[A-Za-z])[xyzXYZ]$")
_AXES = ("xyz", "XYZ")
#: Of several incomplete vectors so many are named.
_MOST = 3


@dataclass(frozen=True)
class MissingAxis:
    """Two columns of a vector without the third.

    Attributes
    ----------
    missing : str
        Name of the column that is not there, spelled as the others are.
    present : tuple of str
        Names of the two that are.
    """

    missing: str
    present: tuple[str, str]

    @property
    def is_of_sensor(self) -> bool:
        """Whether it is of an accelerometer or a gyroscope, or of nothing that its name says ("x-axis")."""
        plain = re.split(r"[(\[]", self.missing)[0]
        words = words_of(plain)
        if len(words) == 1 and len(words[0]) == 2:  # ax, gy
            return words[0][0] in "agw"
        words = [word for word in words if word != "rotation"]  # of a gyroscope, or beside one of its words
        kind = kind_of([*words, *(word[:-1] for word in words if word[-1:] in "xyz")])
        return kind in ("acc", "gyro") or set(words) <= {"x", "y", "z", "axis"}


def missing_axes(names: Sequence[str]) -> list[MissingAxis]:
    """Vectors among the columns of a table of which two axes are there and one is not.

    Parameters
    ----------
    names : sequence of str
        Of all columns, as written.

    Returns
    -------
    list of MissingAxis
        In the order of the columns.
    """
    there = set(names)
    found: dict[str, MissingAxis] = {}
    for name in names:
        for match in reversed(list(_AXIS.finditer(name))):  # the last letter that has a sibling counts
            axes = _AXES[match[0].isupper()]
            triple = [name[: match.start()] + axis + name[match.end() :] for axis in axes]
            present = [each for each in triple if each in there]
            if len(present) == 3:
                break
            if len(present) == 2:
                missing = next(each for each in triple if each not in there)
                found.setdefault(missing, MissingAxis(missing, (present[0], present[1])))
                break
    return list(found.values())


def missing_axes_words(missing: Sequence[MissingAxis]) -> str:
    """What is missing, for a sentence: "no column Gyr_Z beside Gyr_X and Gyr_Y"."""
    said = [
        f"no column {shown(each.missing, 60)} beside {shown(' and '.join(each.present), 120)}"
        for each in missing[:_MOST]
    ]
    more = f" (and {len(missing) - _MOST} more like it)" if len(missing) > _MOST else ""
    return " and ".join(said) + more
