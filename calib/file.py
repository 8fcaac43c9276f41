"""The calibration file: TOML that people can read and edit; its tables of arms, `[sigma]` and sensors."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration, Length, LeverArm, SigmaFactor, SigmaFactors
from smoother.errors import CalibrationError, UnoccludeError
from smoother.recording import ImuStream, Recording
from smoother.rotation import Rotation
from smoother.runtime.inputs import check_input, read_toml, toml_text
from smoother.runtime.outputs import writing
from smoother.runtime.store import large_array

#: What to say instead of pydantic's own words, by its name of the error.
_SAID = {
    "extra_forbidden": "this key is not known",
    "missing": "this key is missing",
    "model_type": "this must be a table",
    "too_short": "this list is too short",
    "too_long": "this list is too long",
}
_UNLIKELY = "this number is beyond {}, which looks like mm or another unit; check its unit"

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
_Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


#: Lengths of an arm and places on it are shorter than 4 m; a sensor's biases smaller than 10 m/s^2, 5 rad/s.
_M = 4.0
_THREE = Field(min_length=3, max_length=3)
_Position = Annotated[list[Annotated[float, Field(ge=-_M, le=_M)]], _THREE]
_Sigmas = Annotated[list[Annotated[float, Field(gt=0, le=_M)]], _THREE]
_AccBias = Annotated[list[Annotated[float, Field(ge=-10.0, le=10.0)]], _THREE]
_GyroBias = Annotated[list[Annotated[float, Field(ge=-5.0, le=5.0)]], _THREE]


class FileSection(BaseModel):
    """A table of a file, whose numbers are finite; further keys are for people."""

    # built where a file is read: most commands read none
    model_config = ConfigDict(allow_inf_nan=False, defer_build=True)


class _Section(FileSection):
    """A table whose keys are all known, and whose numbers are numbers."""

    model_config = ConfigDict(extra="forbid", strict=True)


class _LeverArmSection(_Section):
    position_m: _Position
    sigma_m: _Sigmas


class _ArmSection(_Section):
    """The keys of an arm's table; every one may be absent."""

    upper_arm_m: float | None = Field(default=None, gt=0, le=_M)
    upper_arm_sigma_m: float | None = Field(default=None, gt=0, le=_M)
    R_F_A: _Quaternion | None = None
    accelerometer_bias: _AccBias | None = None
    gyroscope_bias: _GyroBias | None = None
    lever_arm: dict[Literal["elbow", "wrist", "hand"], _LeverArmSection] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.upper_arm_m is None) != (self.upper_arm_sigma_m is None):
            raise ValueError("upper_arm_m and upper_arm_sigma_m must be given together")
        if self.R_F_A is not None and abs(np.linalg.norm(self.R_F_A) - 1) > 1e-3:
            raise ValueError("R_F_A must be a unit quaternion [qw, qx, qy, qz]")
        return self


Model = TypeVar("Model", bound=BaseModel)


def checked(model: type[Model], values: object, where: str) -> Model:
    """A table's values, checked; the error names the first key that is wrong."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join([where, *(str(part) for part in first["loc"] if part != "[key]")])
        said = _SAID.get(first["type"]) or re.sub("^Value error, |^Input (should)", r"\1", first["msg"])
        if (end := {"less_than_equal": "le", "greater_than_equal": "ge"}.get(first["type"])) is not None:
            said = _UNLIKELY.format(f"{first['ctx'][end]:g}")
        raise CalibrationError(f"{key}: {said}.") from error


def _arm_of(side: str, table: object, source: str) -> ArmCalibration:
    """The calibration that the table of a side contains."""
    if side not in SIDES:
        raise CalibrationError(f"{source}: arm.{side} is not one of {', '.join(SIDES)}.")
    if not isinstance(table, dict):
        raise CalibrationError(f"{source}: arm.{side} must be a table, [arm.{side}].")
    section = checked(_ArmSection, table, f"{source}: arm.{side}")
    upper_m, sigma_m, q = section.upper_arm_m, section.upper_arm_sigma_m, section.R_F_A
    acc_bias, gyro_bias = section.accelerometer_bias, section.gyroscope_bias
    return ArmCalibration(
        "" if side == "any" else side,
        {
            joint: LeverArm(np.array(lever.position_m), np.array(lever.sigma_m))
            for joint, lever in section.lever_arm.items()
        },
        None if upper_m is None or sigma_m is None else Length(upper_m, sigma_m),
        None if q is None else Rotation.from_quat(q, scalar_first=True).as_matrix(),
        accelerometer_bias=None if acc_bias is None else np.array(acc_bias),
        gyroscope_bias=None if gyro_bias is None else np.array(gyro_bias),
    )


def _table_of(arm: ArmCalibration) -> dict[str, Any]:
    """The plain values of an arm; what is None is left out."""
    upper_arm, R = arm.upper_arm, arm.R_F_A
    if R is not None and not (np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0):
        raise CalibrationError("R_F_A of the calibration to write is not a rotation matrix.")
    table = {
        "upper_arm_m": upper_arm and float(upper_arm.value_m),
        "upper_arm_sigma_m": upper_arm and float(upper_arm.sigma_m),
        "R_F_A": None if R is None else Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True),
        "accelerometer_bias": arm.accelerometer_bias,
        "gyroscope_bias": arm.gyroscope_bias,
    }
    plain = {
        name: np.asarray(value, dtype=float).tolist() for name, value in table.items() if value is not None
    }
    if arm.lever_arms:
        plain["lever_arm"] = {
            joint: {"position_m": lever.position_m.tolist(), "sigma_m": np.asarray(lever.sigma_m).tolist()}
            for joint, lever in arm.lever_arms.items()
        }
    return plain


def to_toml(document: dict[str, Any], text: str = "") -> str:
    """TOML text of plain values."""
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    reason: Exception | None = None
    for start in (text, ""):  # where tables in an odd order cannot be edited, values count, not comments
        tree = tomlkit.parse(start)
        try:
            _update(tree, document)
            changed = tomlkit.dumps(tree)
        except (TOMLKitError, KeyError, TypeError, ValueError) as error:
            reason = error
            continue
        if not start or tomllib.loads(changed) == document:
            return changed
    raise CalibrationError(f"A calibration file cannot contain such a value: {reason}.") from reason


def _update(table: Any, values: dict[str, Any]) -> None:
    """Give a table of tomlkit these values; what is equal is not touched."""
    for key in [key for key in table if key not in values]:
        del table[key]
    for key, value in values.items():
        if key not in table:
            table[key] = value
        elif isinstance(value, dict) and isinstance(table[key], dict):
            _update(table[key], value)
        elif table[key] != value:
            table[key] = value


FORMAT, VERSION = "unocclude calibration", 1
SIDES = ("right", "left", "any")
#: Tables that identify a calibration without format and version, as written by hand.
TABLES = ("arm", "camera_from_mocap", "camera_from_base", "imu", "forearm", "clock", "sigma")
#: Tables that are merged key by key, and how deep: an arm's lever arms by joint, a sensor's parts by key, the
#: held poses by side. A table below that depth, or any other, replaces the one of its name.
MERGED = {"arm": 3, "imu": 3, "forearm": 1}


@dataclass(frozen=True)
class CalibrationFile:
    """What a calibration file contains.

    Attributes
    ----------
    arms : dict of str to ArmCalibration
        By section: "right", "left" or "any".
    tables : dict
        The other top-level tables by name, as plain TOML values.
    source : str
        What to call the file in messages.
    """

    arms: dict[str, ArmCalibration] = field(default_factory=dict)
    tables: dict[str, Any] = field(default_factory=dict)
    source: str = "the calibration"

    def arm(self, side: str = "") -> ArmCalibration:
        """The calibration of one arm.

        Parameters
        ----------
        side : str
            "right" or "left"; falls back to the section `any`. "" (a recording that does not say) takes
            `any`, or the only arm that there is.

        Returns
        -------
        arm : ArmCalibration

        Raises
        ------
        CalibrationError
            The file has no arm, only the other one, or two for a recording that does not say.
        """
        if side not in ("", "any", "right", "left"):
            raise CalibrationError(f"The side of an arm is right, left or empty, not {side!r}.")
        for section in (side, "any"):
            if section in self.arms:
                return self.arms[section]
        if not self.arms:
            raise CalibrationError(f"{self.source} has no arm; add one with `unocclude calibrate forearm`.")
        if side in ("", "any"):
            if len(self.arms) == 1:
                return next(iter(self.arms.values()))
            raise CalibrationError(
                f"{self.source} has both arms and the recording does not show which is meant; give --side."
            )
        (other,) = self.arms
        raise CalibrationError(
            f"{self.source} is for the {other} arm only, and the recording is of the {side} arm; "
            f"calibrate the {side} arm or give --side {other}."
        )

    def with_arm(self, arm: ArmCalibration) -> CalibrationFile:
        """A copy in which this arm has taken the place of the one of its side ("" is the section `any`)."""
        return replace(self, arms={**self.arms, arm.side or "any": arm})

    def with_table(self, name: str, table: dict[str, Any]) -> CalibrationFile:
        """A copy with another top-level table, which replaces one of that name."""
        return replace(self, tables={**self.tables, name: table})


def read_calibration(path: str | os.PathLike[str]) -> CalibrationFile:
    """Read a calibration file.

    Parameters
    ----------
    path : path-like
        The TOML file.

    Returns
    -------
    file : CalibrationFile

    Raises
    ------
    CalibrationError
        It cannot be read, is not a calibration or a newer one, or a value is wrong; the text names the key.
    """
    source = f"Calibration {path}"
    document = toml_document(Path(path), source)
    if document.get("format", FORMAT if set(TABLES) & set(document) else None) != FORMAT:
        raise CalibrationError(f'{path} is not a calibration: it lacks the line format = "{FORMAT}".')
    version = document.get("version", None if "format" in document else VERSION)
    if type(version) is not int or version < 1:
        raise CalibrationError(f"{source}: version must be a whole number such as {VERSION}.")
    if version > VERSION:
        raise CalibrationError(
            f"{source} has version {version} and this program reads versions up to {VERSION}; update"
            " unocclude."
        )
    sections = document.get("arm", {})
    if not isinstance(sections, dict):
        raise CalibrationError(f"{source}: arm must be a table such as [arm.right].")
    arms = {side: _arm_of(side, section, source) for side, section in sections.items()}
    tables = {name: value for name, value in document.items() if name not in ("format", "version", "arm")}
    for name, value in tables.items():
        if not isinstance(value, dict | list):
            raise CalibrationError(f"{source}: {name} is not a key that a calibration has.")
    return CalibrationFile(arms, tables, source)


def write_calibration(path: str | os.PathLike[str], calibration: CalibrationFile) -> None:
    """Write a calibration into a file, or merge it into the one that exists.

    Of an arm, what `calibration` states replaces what the file contains, lever arms joint by joint, and what
    it leaves open (None) is kept; so are other arms. A sensor's table is merged key by key, held poses side
    by side. Another table replaces the one of its name. Comments and what is not touched stay as they are.
    The file is replaced in one step: it is never seen half written.

    Parameters
    ----------
    path : path-like
        The TOML file.
    calibration : CalibrationFile
        What to write into it.

    Raises
    ------
    CalibrationError
        The existing file is not a calibration that can be read, a value is wrong, or the file cannot be
        written.
    """
    path = Path(path)
    held = ""
    if path.exists():
        read_calibration(path)
        held = toml_text(path)
    text = calibration_text(calibration, path, held)
    try:
        with writing(path, force=True) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    except UnoccludeError as error:
        raise CalibrationError(f"Calibration {path} cannot be written: {error}") from error


def calibration_text(calibration: CalibrationFile, path: Path, held: str = "") -> str:
    """A calibration as the text of its file, merged into the text that the file contains."""
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION} | tomllib.loads(held)
    for name in {"format", "version", "arm"} & set(calibration.tables):
        raise CalibrationError(f"Calibration {path}: an extra table cannot be named {name}.")
    sections = {side: _table_of(arm) for side, arm in calibration.arms.items()}
    for side, section in sections.items():
        _arm_of(side, section, f"Calibration {path}")
    for name, table in (({"arm": sections} if sections else {}) | calibration.tables).items():
        document[name] = _merged(document.get(name), table, MERGED.get(name, 0))
    return to_toml(document, held)


def _merged(held: Any, new: Any, depth: int) -> Any:
    """A table with another merged into it, key by key to some depth."""
    if depth == 0 or not isinstance(held, dict) or not isinstance(new, dict):
        return new
    return {**held, **{key: _merged(held.get(key), value, depth - 1) for key, value in new.items()}}


def toml_document(path: Path, named: str) -> dict[str, Any]:
    """A TOML file as plain values; `named` is what to call it in messages."""
    check_input(path, CalibrationError)
    try:
        return read_toml(path)
    except OSError as error:
        raise CalibrationError(f"{named} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:  # also a number of thousands of digits
        raise CalibrationError(f"{named} is not TOML: {error}.") from error


#: The table's name.
TABLE = "sigma"


class _Gap(FileSection):
    """Gaps of one length."""

    length_s: float = Field(gt=0)
    factor: float = Field(gt=0, le=100)
    count: int = Field(ge=1)


class _SigmaTable(FileSection):
    """The whole table."""

    gaps: list[_Gap] = Field(min_length=1)


def sigma_factors_of(calibration: CalibrationFile) -> SigmaFactors | None:
    """The factors that a calibration file contains."""
    if TABLE not in calibration.tables:
        return None
    table = checked(_SigmaTable, calibration.tables[TABLE], f"{calibration.source}: {TABLE}")
    lengths = [gap.length_s for gap in table.gaps]
    if len(set(lengths)) < len(lengths):
        raise CalibrationError(f"{calibration.source}: {TABLE}.gaps contains a length_s twice.")
    ordered = sorted(table.gaps, key=lambda gap: gap.length_s)
    return SigmaFactors(tuple(SigmaFactor(gap.length_s, gap.factor, gap.count) for gap in ordered))


def known_arm(calibration: CalibrationFile, side: str) -> ArmCalibration | None:
    """What a file knows of an arm, sigma's factors in gaps included; None where it has neither."""
    factors = sigma_factors_of(calibration)
    if calibration.arms:
        return replace(calibration.arm(side), sigma_factors=factors)
    return None if factors is None else ArmCalibration(side, sigma_factors=factors)


def with_sigma_table(
    calibration: CalibrationFile, gaps: list[dict[str, Any]], reference: str, recordings: list[str]
) -> CalibrationFile:
    """A copy with the table of some factors, which replaces the one that there is."""
    return calibration.with_table(TABLE, {"reference": reference, "recordings": recordings, "gaps": gaps})


#: Samples that are corrected together.
_SAMPLES = 65536


class Correction(FileSection):
    """What is read of a sensor's table, corrected = matrix (raw - offset)."""

    offset: Vector | None = None
    matrix: Annotated[list[Vector], Field(min_length=3, max_length=3)] | None = None
    noise_density: float | None = Field(default=None, gt=0, strict=True)  # White, per sqrt(Hz)

    @model_validator(mode="after")
    def _invertible(self) -> Self:
        matrix = np.eye(3) if self.matrix is None else np.array(self.matrix)
        if abs(np.linalg.det(matrix)) < 1e-12 * np.linalg.norm(matrix) ** 3:
            raise ValueError("the matrix has no inverse; correct it or calibrate again")
        return self

    @property
    def is_known(self) -> bool:
        """Whether there is something to correct."""
        return self.offset is not None or self.matrix is not None

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3)."""
        left = raw if self.offset is None else raw - np.array(self.offset)
        return left if self.matrix is None else left @ np.array(self.matrix).T


class SensorCalibration(FileSection):
    """Corrections of one sensor."""

    accelerometer: Correction = Field(default_factory=Correction)
    gyroscope: Correction = Field(default_factory=Correction)
    magnetometer: Correction = Field(default_factory=Correction)

    @property
    def named(self) -> list[str]:
        """What is corrected, in words."""
        return [name for name in type(self).model_fields if getattr(self, name).is_known]

    def apply(self, imu: ImuStream) -> ImuStream:
        """The corrected stream, some thousand samples at a time."""

        def applied(correction: Correction, raw: FloatArray) -> FloatArray:
            values = large_array(raw.shape)
            for start in range(0, len(raw), _SAMPLES):
                rows = slice(start, start + _SAMPLES)
                values[rows] = correction.apply(raw[rows])
            return values

        return replace(
            imu,
            acc=applied(self.accelerometer, imu.acc),
            gyro=applied(self.gyroscope, imu.gyro),
            mag=None if imu.mag is None else applied(self.magnetometer, imu.mag),
            mag_calibrated=imu.mag is not None and self.magnetometer.is_known,
            accelerometer_density=self.accelerometer.noise_density,
            gyroscope_density=self.gyroscope.noise_density,
        )


def sensor_name(topic: str) -> str:
    """A stream's name in the calibration file: its topic without `/imu/`."""
    return topic.strip("/").removeprefix("imu/") or "imu"


def sensor_of(file: CalibrationFile, topic: str) -> SensorCalibration | None:
    """The calibration of a stream's sensor; None where the file has none of that name."""
    held = sensors_in(file).get(sensor_name(topic))
    return held and checked(SensorCalibration, held, f"{file.source}: imu.{sensor_name(topic)}")


def sensors_in(file: CalibrationFile) -> dict[str, Any]:
    """The tables of all sensors, by name."""
    held = file.tables.get("imu", {})
    if not isinstance(held, dict) or not all(isinstance(table, dict) for table in held.values()):
        raise CalibrationError(f"{file.source}: imu must contain a table for each sensor, [imu.NAME].")
    return held


def corrected(recording: Recording, calibration: CalibrationFile) -> Recording:
    """The recording with its IMUs corrected where the file has their calibration, and a note of it."""
    notes: list[str] = []

    def fixed(imu: ImuStream) -> ImuStream:
        found = sensor_of(calibration, imu.name)
        if found is None:
            return imu
        named = [name for name in found.named if name != "magnetometer" or imu.mag is not None]
        said = f"{imu.name}: {', '.join(named)} corrected" if named else f"{imu.name}: nothing to correct"
        if found.accelerometer.noise_density or found.gyroscope.noise_density:
            said += "; its measured noise is used"
        notes.append(f"{said} ({calibration.source})")
        return found.apply(imu)

    base, trunk = recording.base_imu, recording.trunk
    recording = replace(
        recording,
        imu=fixed(recording.imu),
        base_imu=None if base is None else fixed(base),
        further_imus={name: fixed(stream) for name, stream in recording.further_imus.items()},
        trunk=None if trunk is None else replace(trunk, imu=fixed(trunk.imu)),
    )
    known = sensors_in(calibration)
    if known and not notes:
        notes.append(
            f"{calibration.source} corrects {', '.join(sorted(known))}; the recording's IMU is"
            f" {recording.imu.name} and was left uncorrected"
        )
    return replace(recording, notes=(*recording.notes, *notes))


def corrected_streams(streams: Sequence[ImuStream], file: CalibrationFile) -> tuple[list[ImuStream], bool]:
    """Streams of one IMU corrected by the file's values, and whether its accelerometer is known."""
    sensor = sensor_of(file, streams[0].name)
    if sensor is None:
        return list(streams), False
    once = {id(stream): sensor.apply(stream) for stream in streams}
    return [once[id(stream)] for stream in streams], sensor.accelerometer.is_known
