"""`[sigma]` of a calibration file: how much wider sigma must be in gaps, as hidden gaps have shown.

::

    [sigma]
    reference = "wrist"        # what the hidden gaps were compared with
    recordings = ["walk.mcap"]

    [[sigma.gaps]]             # one a length of gap
    length_s = 1.0
    factor = 1.62              # what `smooth` multiplies sigma of positions by
    count = 24                 # hidden gaps behind it; the rest is for people
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from smoother.calibration import SigmaFactor, SigmaFactors
from smoother.errors import CalibrationError

from .file import CalibrationFile

#: The table's name.
TABLE = "sigma"


class _Gap(BaseModel):
    """Gaps of one length; further keys are for people."""

    model_config = ConfigDict(allow_inf_nan=False)

    length_s: float = Field(gt=0)
    factor: float = Field(gt=0, le=100)
    count: int = Field(ge=1)


class _Table(BaseModel):
    """The whole table."""

    gaps: list[_Gap] = Field(min_length=1)


def sigma_factors_of(calibration: CalibrationFile) -> SigmaFactors | None:
    """The factors that a calibration file holds.

    Parameters
    ----------
    calibration : CalibrationFile

    Returns
    -------
    factors : SigmaFactors or None
        None without the table.

    Raises
    ------
    CalibrationError
        A value of the table is wrong; the text names the key.
    """
    if TABLE not in calibration.tables:
        return None
    try:
        table = _Table.model_validate(calibration.tables[TABLE])
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([TABLE, *(str(part) for part in first["loc"])])
        words = first["msg"].removeprefix("Input ")
        raise CalibrationError(f"{calibration.source}: {key}: {words[0].lower()}{words[1:]}.") from error
    lengths = [gap.length_s for gap in table.gaps]
    if len(set(lengths)) < len(lengths):
        raise CalibrationError(f"{calibration.source}: {TABLE}.gaps holds a length_s twice.")
    ordered = sorted(table.gaps, key=lambda gap: gap.length_s)
    return SigmaFactors(tuple(SigmaFactor(gap.length_s, gap.factor, gap.count) for gap in ordered))


def with_sigma_table(
    calibration: CalibrationFile, gaps: list[dict[str, Any]], reference: str, recordings: list[str]
) -> CalibrationFile:
    """A copy with the table of some factors, which replaces the one that there is.

    Parameters
    ----------
    calibration : CalibrationFile
    gaps : list of dict
        A row a length, with at least `length_s`, `factor` and `count`.
    reference : str
        What hidden gaps were compared with.
    recordings : list of str
        Where they were hidden.
    """
    return calibration.with_table(TABLE, {"reference": reference, "recordings": recordings, "gaps": gaps})
