"""All joint angles of a recovery with their sigmas: what every output reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..array_types import FloatArray
from ..body import HAND
from ..result import Recovery
from ..runtime.packages import pandas_module
from .definitions import (
    ELBOW_FLEXION,
    JOINT_ANGLES,
    PRONATION,
    SHOULDER,
    SHOULDER_ELEVATION,
    SHOULDER_PLANE,
    SHOULDER_TRUNK,
    WRIST,
    JointAngle,
)
from .found import (
    SHOULDER_NAMES,
    Angles,
    ForearmMounting,
    Found,
    angles_by_joints,
    forearm_mounting,
    shoulder_angles,
    wrist_angles,
)

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, repr=False)
class AngleTable:
    """Joint angles sample by sample, in degrees."""

    t_s: FloatArray  # (N,) s: as in the recovery
    angles: tuple[JointAngle, ...]  # Its rows, in the order of columns
    values: Angles  # dict of (N,) deg: by the angles' names
    sigmas: Angles  # dict of (N,) deg: their standard deviations
    reasons: dict[str, str]  # Why an angle is empty, throughout or in part, or has no row

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        lines = [f"Joint angles of {len(self)} samples, degrees"]
        for angle in self.angles:
            known = self.values[angle.name][np.isfinite(self.values[angle.name])]
            said = f"{known.min():.1f} to {known.max():.1f}" if len(known) else "empty"
            sigma = self.sigmas[angle.name][np.isfinite(self.sigmas[angle.name])]
            said += f", median sigma {np.median(sigma):.1f}" if len(sigma) else ""
            lines.append(f"{angle.column}: {said}")
        lines += [f"{name}: {reason}" for name, reason in self.reasons.items()]
        return "\n".join(lines)

    def to_arrays(self) -> dict[str, FloatArray]:
        """The columns of all outputs: `NAME_deg` and `NAME_sigma_deg` of each angle, (N,) each."""
        columns = {}
        for angle in self.angles:
            columns[angle.column] = self.values[angle.name]
            columns[angle.sigma_column] = self.sigmas[angle.name]
        return columns

    def to_dataframe(self) -> pandas.DataFrame:
        """`t_s` and the columns of `to_arrays` as a pandas table."""
        pandas = pandas_module()
        return pandas.DataFrame({"t_s": self.t_s, **self.to_arrays()})


def joint_angles(arm: Recovery, mounting: ForearmMounting | None = None) -> AngleTable:
    """Every joint angle of a recovery with its sigma, by this mounting of the forearm's IMU or its own."""
    mounting = mounting or forearm_mounting(arm)
    shown = {ELBOW_FLEXION, *SHOULDER, PRONATION}
    if arm.trunk is not None:
        shown.update(SHOULDER_TRUNK)
    if HAND.name in arm.segments:
        shown.update(WRIST)
    rows = tuple(angle for angle in JOINT_ANGLES if angle in shown)
    values, sigmas = ({angle.name: np.full(len(arm), np.nan) for angle in rows} for _ in range(2))
    start = 0
    for batch in arm.batches():
        part = slice(start, start + len(batch))
        for columns, of_batch in zip((values, sigmas), _angles_of(batch, mounting), strict=True):
            for name, column in columns.items():
                column[part] = of_batch[name]
        start = part.stop
    reasons, answered = {}, arm.answered
    for angle in rows:
        known, reason = np.isfinite(values[angle.name]), ""
        if not known.any():
            reason = _why_nowhere(arm, mounting, angle)
        elif not known.all():
            why = "a joint or an orientation is not known"
            if not (answered & ~known).any():
                why = "the method has no answer"
            reason = f"Empty in {100 * float((~known).mean()):.2g} % of the samples, where {why}."
        elif not np.isfinite(sigmas[angle.name]).any():
            reason = f"The method {arm.method} states no uncertainty: sigma is empty."
        if reason:
            reasons[angle.name] = reason
    if arm.trunk is None:
        absent = "The trunk is not known: no IMU is on it, and the skeleton does not show both shoulders."
        reasons |= {angle.name: absent for angle in SHOULDER_TRUNK}
    return AngleTable(arm.t_s, rows, values, sigmas, reasons)


def _angles_of(samples: Recovery, mounting: ForearmMounting) -> Found:
    """By the joints, and the shoulder by its own IMU where there is one; the wrist by the hand's."""
    values, sigmas = angles_by_joints(samples, mounting)
    if samples.upper is not None:
        _fill(values, sigmas, shoulder_angles(samples))
    if samples.trunk is not None:
        to_trunk = angles_by_joints(samples, mounting, SHOULDER_NAMES, samples.trunk)
        if samples.upper is not None:
            _fill(*to_trunk, shoulder_angles(samples, samples.trunk))
        for columns, found in zip((values, sigmas), to_trunk, strict=True):
            columns.update({f"{name}_trunk": column for name, column in found.items()})
    if HAND.name in samples.segments:
        for columns, found in zip((values, sigmas), wrist_angles(samples, mounting), strict=True):
            columns.update(found)
    return values, sigmas


def _fill(values: Angles, sigmas: Angles, own: Found) -> None:
    """Put another source's values and sigmas where it has any."""
    for name, column in own[0].items():
        there = np.isfinite(column)
        values[name] = np.where(there, column, values[name])
        sigmas[name] = np.where(there, own[1][name], sigmas[name])


def _why_nowhere(arm: Recovery, mounting: ForearmMounting, angle: JointAngle) -> str:
    """Why an angle is known at no sample, a sentence."""
    if angle in WRIST:
        return mounting.reason or "The IMUs on hand and forearm never have samples at the same time."
    needed = ["shoulder", "elbow", "wrist"]
    if angle in (SHOULDER_PLANE, SHOULDER_ELEVATION, *SHOULDER_TRUNK):
        needed.remove("wrist")
    for joint in needed:
        if joint not in arm.joints or not np.isfinite(arm.joints[joint]).any():
            return f"The recording has no {joint}."
    if angle in SHOULDER_TRUNK:
        return "Trunk and upper arm are never known at the same time."
    if angle is PRONATION:
        return mounting.reason or f"The method {arm.method} gives no orientation of the forearm's IMU."
    if angle in SHOULDER and not np.isfinite(arm.gravity_direction).all():
        return f"The method {arm.method} does not solve the direction of gravity, the angle's reference."
    return f"{', '.join(needed[:-1]).capitalize()} and {needed[-1]} are never known at the same time."
