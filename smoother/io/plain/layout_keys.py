"""What recording.toml says of tables: where they are, their layout, columns and units."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ...recording import CameraFrame
from ...units import STANDARD_GRAVITY

Column = str | int
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
ACCELERATION = {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY / 1000}
ANGULAR_VELOCITY = {"rad/s": 1.0, "deg/s": np.pi / 180, "mdps": np.pi / 180_000}
_LAYOUT_KEYS = {"separator", "skip_rows", "columns", "time_unit", "rate_hz"}


class TableKeys(BaseModel):
    """How a table is laid out; what is not given is looked for.

    Attributes
    ----------
    separator : str, optional
        ",", ";", a tab or a blank (any number of them).
    skip_rows : int, optional
        Lines above the header, or above the rows where there is none.
    columns : dict, optional
        Name in the file, or number from 1, by what it is.
    time_unit : str
        "s", "ms", "us", "ns", "iso" (dates), "counter" (samples, with `rate_hz`).
    rate_hz : float, Hz, optional
        Of a table without times, or of a counter.
    """

    model_config = ConfigDict(extra="forbid")
    separator: str | None = None
    skip_rows: int | None = Field(None, ge=0)
    time_unit: Literal["s", "ms", "us", "ns", "iso", "counter"] = "s"
    rate_hz: float | None = Field(None, gt=0)


class ImuKeys(TableKeys):
    """Files of an IMU; units count for all of them."""

    file: str | list[str]
    columns: dict[str, Column] | list[dict[str, Column]] | None = None
    accelerometer_unit: Literal["m/s^2", "g", "mg"] = "m/s^2"
    gyroscope_unit: Literal["rad/s", "deg/s", "mdps"] = "rad/s"

    @property
    def is_plain(self) -> bool:
        """Whether the file is one with the product's own columns."""
        return isinstance(self.file, str) and not self.model_fields_set & _LAYOUT_KEYS


class CameraKeys(TableKeys):
    """The skeleton's file: a row a joint (columns joint, x, y, z), or a row a frame (wrist_right = ..)."""

    frame: CameraFrame
    skeleton: str | None = None
    gravity: list[float] | None = Field(None, min_length=3, max_length=3)
    position_unit: Literal["m", "cm", "mm"] = "m"
    columns: dict[str, Column | list[Column]] | None = None
    states: dict[str, Literal["tracked", "inferred", "not_tracked"]] | None = None

    @property
    def is_plain(self) -> bool:
        """Whether the file is one with the product's own columns."""
        return not self.model_fields_set & (_LAYOUT_KEYS | {"states"})
