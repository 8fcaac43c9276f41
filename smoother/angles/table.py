"""All joint angles of a recovery with their sigmas: what every output reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..array_types import FloatArray
from ..result import Recovery
from ..runtime.packages import pandas_module
from ..shoulder_angles import shoulder_angles, trunk_angles
from .definitions import ELBOW_FLEXION, JOINT_ANGLES, PRONATION, SHOULDER, SHOULDER_TRUNK, WRIST, JointAngle
from .forearm_mounting import ForearmMounting, forearm_mounting
from .skeleton import Angles, skeleton_angles, skeleton_trunk_angles
from .wrist import why_no_wrist, wrist_angles

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, repr=False)
class AngleTable:
    """Joint angles sample by sample, in degrees."""

    t_s: FloatArray  # (N,) s: as in the recovery
    angles: tuple[JointAngle, ...]  # Its rows, in the order of columns
    values: Angles  # dict of (N,) deg: by the angles' names
    sigmas: Angles  # dict of (N,) deg: by the angles' names
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


@dataclass(frozen=True)
class _Source:
    """Angles that are computed together; a sensor on a further segment is one more of these."""

    angles: tuple[JointAngle, ...]  # Rows of the table
    # (samples, the recording's mounting) to values and sigmas by name, nan where not known
    compute: Callable[[Recovery, ForearmMounting], tuple[Angles, Angles]]
    # (recording, its mounting, an angle's name) to the reason why it is nowhere known
    missing: Callable[[Recovery, ForearmMounting, str], str]
    is_shown: Callable[[Recovery], bool] = lambda arm: True  # Whether a recording has these rows at all
    absent: str = ""  # The reason why not, a sentence; "" where it is obvious


class JointAngles:
    """Computes the angles of a recording: what is the same in all of it is found once."""

    def __init__(self, arm: Recovery) -> None:
        self._arm = arm
        self.mounting = forearm_mounting(arm)
        self._sources = [source for source in _SOURCES if source.is_shown(arm)]
        shown = {angle.name for source in self._sources for angle in source.angles}
        #: Rows of the table.
        self.angles = tuple(angle for angle in JOINT_ANGLES if angle.name in shown)

    def at(self, samples: Recovery) -> tuple[Angles, Angles]:
        """Values and sigmas by name, degrees, of some of the recording's samples."""
        values: Angles = {}
        sigmas: Angles = {}
        for source in self._sources:
            of_values, of_sigmas = source.compute(samples, self.mounting)
            values |= {angle.name: of_values[angle.name] for angle in source.angles}
            sigmas |= {angle.name: of_sigmas[angle.name] for angle in source.angles}
        return values, sigmas

    def table(self) -> AngleTable:
        """Of all samples."""
        count = len(self._arm)
        values = {angle.name: np.full(count, np.nan) for angle in self.angles}
        sigmas = {angle.name: np.full(count, np.nan) for angle in self.angles}
        answered = np.zeros(count, bool)
        start = 0
        for batch in self._arm.batches():
            rows = slice(start, start + len(batch))
            for columns, of_batch in zip((values, sigmas), self.at(batch), strict=True):
                for name, part in of_batch.items():
                    columns[name][rows] = part
            answered[rows] = np.isfinite(batch.position).all(axis=1)
            start = rows.stop
        reasons = {}
        for source in self._sources:
            for angle in source.angles:
                if reason := self._reason(source, angle.name, values[angle.name], answered):
                    reasons[angle.name] = reason
                elif not np.isfinite(sigmas[angle.name]).any():
                    reasons[angle.name] = (
                        f"The method {self._arm.method} states no uncertainty: sigma is empty."
                    )
        for source in _SOURCES:
            if source.absent and source not in self._sources:
                reasons |= {angle.name: source.absent for angle in source.angles}
        return AngleTable(self._arm.t_s, self.angles, values, sigmas, reasons)

    def _reason(self, source: _Source, name: str, values: FloatArray, answered: np.ndarray) -> str:
        """Why an angle is empty, throughout or in part; "" where it is not."""
        known = np.isfinite(values)
        if not known.any():
            return source.missing(self._arm, self.mounting, name)
        share = float((~known).mean())
        if not share:
            return ""
        no_answer = not (answered & ~known).any()
        why = "the method has no answer" if no_answer else "a joint or an orientation is not known"
        return f"Empty in {100 * share:.2g} % of the samples, where {why}."


def joint_angles(arm: Recovery) -> AngleTable:
    """Every joint angle of a recovery with its sigma."""
    return JointAngles(arm).table()


def _arm(samples: Recovery, mounting: ForearmMounting) -> tuple[Angles, Angles]:
    """By the joints; the shoulder by its own IMU where there is one."""
    found = skeleton_angles(samples, mounting)
    return found if samples.upper is None else _filled(shoulder_angles(samples), found)


def _trunk(samples: Recovery, mounting: ForearmMounting) -> tuple[Angles, Angles]:
    """Likewise, against the trunk."""
    found = skeleton_trunk_angles(samples, mounting)
    return found if samples.upper is None else _filled(trunk_angles(samples), found)


def _filled(first: tuple[Angles, Angles], second: tuple[Angles, Angles]) -> tuple[Angles, Angles]:
    """The second's values and sigmas, and the first's where it has any."""
    values, sigmas = (dict(columns) for columns in second)
    for name, own in first[0].items():
        there = np.isfinite(own)
        values[name] = np.where(there, own, values[name])
        sigmas[name] = np.where(there, first[1][name], sigmas[name])
    return values, sigmas


def _why_no_arm(arm: Recovery, mounting: ForearmMounting, name: str) -> str:
    needed = ["shoulder", "elbow", "wrist"]
    if name in (angle.name for angle in SHOULDER[:2]):
        needed.remove("wrist")
    for joint in needed:
        if joint not in arm.joints or not np.isfinite(arm.joints[joint]).any():
            return f"The recording has no {joint}."
    if name == PRONATION.name and mounting.R_F_A is None:
        return mounting.reason
    if name in (angle.name for angle in SHOULDER) and not np.isfinite(arm.gravity_direction).all():
        return f"The method {arm.method} does not solve the direction of gravity, the angle's reference."
    if name == PRONATION.name:
        return f"The method {arm.method} gives no orientation of the forearm's IMU."
    return f"{', '.join(needed[:-1]).capitalize()} and {needed[-1]} are never known at the same time."


def _why_no_trunk(arm: Recovery, mounting: ForearmMounting, name: str) -> str:
    for joint in ("shoulder", "elbow"):
        if joint not in arm.joints or not np.isfinite(arm.joints[joint]).any():
            return f"The recording has no {joint}."
    return "Trunk and upper arm are never known at the same time."


_NO_TRUNK = "The trunk is not known: no IMU is on it, and the skeleton does not show both shoulders."
_SOURCES = (
    _Source((ELBOW_FLEXION, *SHOULDER, PRONATION), _arm, _why_no_arm),
    _Source(SHOULDER_TRUNK, _trunk, _why_no_trunk, lambda arm: arm.trunk is not None, _NO_TRUNK),
    _Source(WRIST, wrist_angles, why_no_wrist, lambda arm: "hand" in arm.segments),
)
