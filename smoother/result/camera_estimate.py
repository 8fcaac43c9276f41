"""What was found of each camera of a recording: where it stands, its clock, and when it saw the forearm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from ..array_types import BoolArray, FloatArray

Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class CameraEstimate:
    """A camera {C} of a recording in the first one's frame {K}.

    Attributes
    ----------
    name : str
    R_K_C : tuple of tuple of float, (3, 3), optional
        Maps a vector from {C} to {K}; None if unknown.
    p_K_C_m : tuple of float, (3,), m, optional
        Its origin in {K}.
    sigma_m, sigma_deg : float, m and degrees per axis
        One standard deviation of both; 0 of the first camera, which defines {K}.
    offset_s, offset_sigma_s : float, s
        t_first = t_own + offset, in the middle of the recording.
    skew : float, s/s
        Steady drift of its clock against the first one's.
    misfit_m : float, m
        Median distance of its joints from the first one's, what is constant taken off.
    together_s : float, s
        Time during which both saw the forearm.
    joint_sigma_m : dict of str to float, m per axis
        Noise of its joints' samples.
    reason : str
        Why it was left out; "" where it is used.
    seen_s : tuple of (float, float), s
        When it saw the forearm, on the IMU's clock.
    """

    name: str
    R_K_C: Matrix | None = None
    p_K_C_m: tuple[float, ...] | None = None
    sigma_m: float | None = None
    sigma_deg: float | None = None
    offset_s: float | None = None
    offset_sigma_s: float | None = None
    skew: float | None = None
    misfit_m: float | None = None
    together_s: float | None = None
    joint_sigma_m: dict[str, float] = field(default_factory=dict)
    reason: str = ""
    seen_s: tuple[tuple[float, float], ...] = ()

    @property
    def takes_part(self) -> bool:
        """Its samples are in the answer."""
        return not self.reason

    def saw_at(self, t_s: FloatArray) -> BoolArray:
        """Whether it saw the forearm at times (n,), s on the IMU's clock."""
        if not self.seen_s:
            return np.zeros(len(t_s), bool)
        start, end = np.array(self.seen_s).T
        row = np.clip(np.searchsorted(start, t_s, side="right") - 1, 0, None)
        return np.asarray((t_s >= start[row]) & (t_s <= end[row]))

    def plain(self) -> dict[str, object]:
        """Plain values by name; what is not known is left out."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: _listed(value) for name, value in values.items() if value is not None}

    @classmethod
    def from_plain(cls, value: Any) -> CameraEstimate | None:
        """From plain values; None where they are of another kind."""
        if not isinstance(value, Mapping) or not isinstance(value.get("name"), str):
            return None
        try:
            numbers = {
                name: float(value[name])
                for name in ("sigma_m", "sigma_deg", "offset_s", "offset_sigma_s", "skew", "misfit_m")
                if value.get(name) is not None
            }
            return cls(
                value["name"],
                None if value.get("R_K_C") is None else _rows(value["R_K_C"], 3),
                None if value.get("p_K_C_m") is None else tuple(float(x) for x in value["p_K_C_m"]),
                together_s=None if value.get("together_s") is None else float(value["together_s"]),
                joint_sigma_m={str(k): float(v) for k, v in dict(value.get("joint_sigma_m", {})).items()},
                reason=str(value.get("reason", "")),
                seen_s=tuple((float(a), float(b)) for a, b in value.get("seen_s", ())),
                **numbers,
            )
        except (TypeError, ValueError):
            return None


def _rows(value: Sequence[Sequence[float]], width: int) -> Matrix:
    rows = tuple(tuple(float(x) for x in row) for row in value)
    if len(rows) != width or any(len(row) != width for row in rows):
        raise ValueError("no square matrix")
    return rows


def _listed(value: Any) -> Any:
    return [_listed(item) for item in value] if isinstance(value, tuple) else value


def cameras_from_plain(values: Any) -> tuple[CameraEstimate, ...] | None:
    """A recording's cameras from plain values; None where they are of another kind."""
    if not isinstance(values, list | tuple):
        return None
    cameras = [CameraEstimate.from_plain(value) for value in values]
    return None if None in cameras else tuple(camera for camera in cameras if camera is not None)
