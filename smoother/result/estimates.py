"""What a method estimated besides the motion, and its verdict; as plain values and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ..array_types import BoolArray, FloatArray
from ..recording import JOINTS
from .verdict import (
    Finding,
    Matrix,
    Pairing,
    SelfCheck,
    UntrustedInterval,
    Vector,
    field_from_plain,
    plain,
)

Joint = Annotated[str, Field(pattern=f"^({'|'.join(JOINTS)})$")]


@dataclass(frozen=True)
class CameraEstimate:
    """A camera {C} of a recording in the first one's frame {K}."""

    name: str
    R_K_C: Matrix | None = None  # (3, 3): Maps a vector from {C} to {K}; None if unknown
    p_K_C_m: Vector | None = None  # (3,), m: Its origin in {K}
    # m and degrees per axis: One standard deviation of both; 0 of the first camera, which defines {K}
    sigma_m: float | None = None
    sigma_deg: float | None = None
    offset_s: float | None = None  # s: t_first = t_own + offset, in the middle of the recording
    offset_sigma_s: float | None = None
    skew: float | None = None  # s/s: Steady drift of its clock against the first one's
    # m: Median distance of its joints from the first one's, what is constant taken off
    misfit_m: float | None = None
    together_s: float | None = None  # s: Time during which both saw the forearm
    joint_sigma_m: dict[str, float] = field(default_factory=dict)  # m per axis: Noise of its joints' samples
    reason: str = ""  # Why it was left out; "" where it is used
    seen_s: tuple[tuple[float, float], ...] = ()  # s: When it saw the forearm, on the IMU's clock

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


@dataclass(frozen=True)
class Estimates:
    """What a method found besides the motion; None where it states nothing."""

    # m per axis: Noise of a joint's sample; of a white noise with the same long-run variance
    camera_sigma_m: dict[Joint, float] | None = None
    camera_effective_sigma_m: dict[Joint, float] | None = None
    # m: Constant errors of the camera's joints (x, y, z in {K}), free of their common part
    joint_bias_m: dict[Joint, Vector] | None = None
    joint_bias_sigma_m: float | None = None  # m per axis: How large such an error is in this recording
    accelerometer_bias: Vector | None = None  # m/s^2: mean over the recording, in {A}
    gyroscope_bias: Vector | None = None  # rad/s
    # Means of the magnetic field over some seconds, and how many were used
    magnetometer_blocks: int | None = None
    magnetometer_blocks_used: int | None = None
    # degrees: How well the field's direction is believed to be known
    magnetometer_sigma_deg: float | None = None
    magnetic_field_direction: Vector | None = None  # Unit vector in {K}
    # What of the arm was given beforehand: lever arms by joint, `upper_arm`, `R_F_A`
    given: tuple[str, ...] = ()
    # m: Samples less certain than this on any axis are marked as not to be used
    max_sigma_m: float | None = None
    # By gap what its sigma of positions was multiplied by, from a calibration
    sigma_factors: tuple[float, ...] = ()
    trusted: bool | None = None  # There is no sign that the set-up was wrong or the answer impossible
    reasons: tuple[str, ...] = ()  # Why it is not trusted
    cautions: tuple[str, ...] = ()  # What to take care of where it is trusted
    # The likeliest cause where it is not trusted, and what to do; the first of the reasons
    cause: str | None = None
    # Options that undo the cause ("--mirror x"); of several either one may be meant
    remedies: tuple[str, ...] = ()
    untrusted: tuple[UntrustedInterval, ...] = ()  # Times that are not to be trusted where the rest is
    # All that was found, with its kind: what `reasons`, `cautions` and `untrusted` say
    findings: tuple[Finding, ...] = ()
    self_check: SelfCheck | None = None  # Visible stretches that were hidden and recovered
    pairing: Pairing | None = None  # Whether skeleton and IMU were shown to be of one motion
    # s: Mean offset and sigma of a clock that was measured and given beforehand; t_imu = t_camera + offset
    clock_given_s: Annotated[tuple[float, ...], Field(min_length=2, max_length=2)] | None = None
    # Where a recording has several: the first one, then the further ones
    cameras: tuple[CameraEstimate, ...] = ()
    # What else a file or a baseline states, by name
    further: Mapping[str, object] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """One sentence to act on; "" where not judged."""
        if self.trusted is None:
            return ""
        if not self.trusted and self.cause:
            return f"Not to be trusted: {self.cause}."
        if not self.trusted:
            return f"Not to be trusted: {'; '.join(self.reasons)}."
        return f"Usable with care: {'; '.join(self.cautions)}." if self.cautions else "Usable."

    def with_findings(self, more: Iterable[Finding]) -> Estimates:
        """A remark is a caution; what contradicts some times takes their trust, or that of the whole."""
        found = tuple(dict.fromkeys(more))
        reasons = [each.sentence for each in found if each.severity == "recording"]
        return replace(
            self,
            trusted=False if reasons or self.reasons else self.trusted,
            reasons=tuple(dict.fromkeys((*self.reasons, *reasons))),
            cautions=(*self.cautions, *(each.sentence for each in found if each.severity == "caution")),
            untrusted=(
                *self.untrusted,
                *(
                    UntrustedInterval(each.start_s, each.end_s, (each.sentence,))
                    for each in found
                    if each.start_s is not None and each.end_s is not None
                ),
            ),
            findings=tuple(dict.fromkeys((*self.findings, *found))),
        )

    def plain(self) -> dict[str, object]:
        """Plain values by name, as files and `--json` state them; what is not stated is left out."""
        stated = plain(replace(self, further={}))
        stated["cameras"] = [_stated(camera, None) for camera in stated["cameras"]]
        del stated["further"]
        return _stated(stated, None, []) | dict(self.further)

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> Estimates:
        """From plain values; unknown names, or values of another kind, stay in `further`."""
        names = {each.name for each in fields(cls)} - {"further"}
        checked = {
            name: field_from_plain(cls, name, value) for name, value in values.items() if name in names
        }
        stated = {name: value for name, value in checked.items() if value is not None}
        return cls(**stated, further={name: value for name, value in values.items() if name not in stated})


def _stated(values: dict[str, Any], *left_out: object) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value not in left_out}
