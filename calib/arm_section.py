"""The table of an arm in the calibration file: its keys, their limits, and the calibration that it holds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.errors import CalibrationError
from smoother.rotation import Rotation

#: Lengths of an arm and places on it are shorter than this, m; a sensor's biases smaller than those.
LONGEST_M = 4.0
LARGEST_ACC_BIAS, LARGEST_GYRO_BIAS = 10.0, 5.0

#: What to say instead of pydantic's own words, by its name of the error.
_SAID = {
    "extra_forbidden": "this key is not known",
    "missing": "this key is missing",
    "model_type": "this must be a table",
    "too_short": "this list is too short",
    "too_long": "this list is too long",
}

_Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
_Sigmas = Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=3, max_length=3)]
_Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class _Section(BaseModel):
    """A table whose keys are all known; numbers are numbers and finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _LeverArmSection(_Section):
    position_m: _Vector
    sigma_m: _Sigmas

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for name, values in (("position_m", self.position_m), ("sigma_m", self.sigma_m)):
            if max(map(abs, values)) > LONGEST_M:
                raise ValueError(f"{name} is beyond {LONGEST_M:g} m, which looks like mm; give it in m")
        return self


class ArmSection(_Section):
    """The keys of an arm's table; every one may be absent."""

    upper_arm_m: float | None = Field(default=None, gt=0)
    upper_arm_sigma_m: float | None = Field(default=None, gt=0)
    R_F_A: _Quaternion | None = None
    accelerometer_bias: _Vector | None = None
    gyroscope_bias: _Vector | None = None
    lever_arm: dict[Literal["elbow", "wrist", "hand"], _LeverArmSection] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.upper_arm_m is None) != (self.upper_arm_sigma_m is None):
            raise ValueError("upper_arm_m and upper_arm_sigma_m must be given together")
        limits = (
            ("upper_arm_m", [self.upper_arm_m], LONGEST_M, "m"),
            ("upper_arm_sigma_m", [self.upper_arm_sigma_m], LONGEST_M, "m"),
            ("accelerometer_bias", self.accelerometer_bias, LARGEST_ACC_BIAS, "m/s^2"),
            ("gyroscope_bias", self.gyroscope_bias, LARGEST_GYRO_BIAS, "rad/s"),
        )
        for name, values, most, unit in limits:
            if any(abs(value) > most for value in values or [] if value is not None):
                raise ValueError(f"{name} is beyond {most:g} {unit}; check its unit")
        if self.R_F_A is not None and abs(np.linalg.norm(self.R_F_A) - 1) > 1e-3:
            raise ValueError("R_F_A must be a unit quaternion [qw, qx, qy, qz]")
        return self


def checked_section(section: object, where: str, path: Path) -> ArmSection:
    """The keys of an arm, checked.

    Parameters
    ----------
    section : object
        Plain values of the table.
    where : str
        Its name in the file, for messages.
    path : Path
        The file, for messages.

    Raises
    ------
    CalibrationError
        It is no table, or a value is wrong; the text names the key.
    """
    if not isinstance(section, dict):
        raise CalibrationError(f"Calibration {path}: {where} must be a table, [{where}].")
    try:
        return ArmSection.model_validate(section)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([where, *(str(part) for part in first["loc"] if part != "[key]")])
        said = _SAID.get(first["type"]) or re.sub("^Value error, |^Input (should)", r"\1", first["msg"])
        raise CalibrationError(f"Calibration {path}: {key}: {said}.") from error


def arm_of_section(side: str, section: ArmSection) -> ArmCalibration:
    """The calibration that the table of a side holds."""

    def array(values: list[float] | None) -> FloatArray | None:
        return None if values is None else np.array(values, dtype=np.float64)

    upper_arm = None
    if section.upper_arm_m is not None and section.upper_arm_sigma_m is not None:
        upper_arm = Length(section.upper_arm_m, section.upper_arm_sigma_m)
    R_F_A = None
    if section.R_F_A is not None:
        R_F_A = Rotation.from_quat(np.roll(section.R_F_A, -1)).as_matrix()
    return ArmCalibration(
        side="" if side == "any" else side,
        lever_arms={
            joint: LeverArm(np.array(arm.position_m, dtype=float), np.array(arm.sigma_m, dtype=float))
            for joint, arm in section.lever_arm.items()
        },
        upper_arm=upper_arm,
        R_F_A=R_F_A,
        accelerometer_bias=array(section.accelerometer_bias),
        gyroscope_bias=array(section.gyroscope_bias),
    )


def section_of_arm(arm: ArmCalibration) -> dict[str, Any]:
    """The plain values of an arm; what is None is left out."""
    section: dict[str, Any] = {}
    if arm.upper_arm is not None:
        section["upper_arm_m"] = float(arm.upper_arm.value_m)
        section["upper_arm_sigma_m"] = float(arm.upper_arm.sigma_m)
    if arm.R_F_A is not None:
        if not np.allclose(arm.R_F_A @ arm.R_F_A.T, np.eye(3), atol=1e-6) or np.linalg.det(arm.R_F_A) < 0:
            raise CalibrationError("R_F_A of the calibration to write is not a rotation matrix.")
        quaternion = np.roll(Rotation.from_matrix(arm.R_F_A).as_quat(canonical=True), 1)
        section["R_F_A"] = quaternion.tolist()
    for name in ("accelerometer_bias", "gyroscope_bias"):
        if (bias := getattr(arm, name)) is not None:
            section[name] = np.asarray(bias, dtype=float).tolist()
    if arm.lever_arms:
        section["lever_arm"] = {
            joint: {
                "position_m": np.asarray(lever.position_m, dtype=float).tolist(),
                "sigma_m": np.asarray(lever.sigma_m, dtype=float).tolist(),
            }
            for joint, lever in arm.lever_arms.items()
        }
    return section
