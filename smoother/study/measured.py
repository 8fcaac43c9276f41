"""The measures of a recording's arms, as a study's row holds them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..measures import Measures
from ..result import Recovery
from ..runtime.printable import plain
from .columns import MEASURE_FIELDS

#: Of a measure itself; the other fields are of its arm.
_OWN = tuple(name for name, *_ in MEASURE_FIELDS if name not in ("side", "body", "trusted"))


def measure_rows(measured: Sequence[Measures]) -> list[dict[str, Any]]:
    """The measures of sessions, as the column `measures` holds them.

    Parameters
    ----------
    measured : sequence of Measures
        One an arm.

    Returns
    -------
    rows : list of dict
        By the names of `MEASURE_FIELDS`; numbers that are not finite are None. No name of a recording, no
        time of day.
    """
    return [
        {"side": arm.side, "body": arm.body, "trusted": arm.trusted}
        | {name: plain(getattr(measure, name)) for name in _OWN}
        for arm in measured
        for measure in arm.session
    ]


def measured_arms(recoveries: Sequence[Recovery]) -> list[dict[str, Any]]:
    """Measure every arm of a recording with the usual settings (`measure_rows`)."""
    from ..measures import measure

    return measure_rows([measure(recovery) for recovery in recoveries])
