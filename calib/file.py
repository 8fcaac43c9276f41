"""The calibration file: versioned TOML that people can read and edit, and its table `[sigma]`."""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from smoother.calibration import ArmCalibration, SigmaFactor, SigmaFactors
from smoother.errors import CalibrationError, UnoccludeError
from smoother.runtime.inputs import check_input, read_toml, toml_text
from smoother.runtime.outputs import writing

from .arm_section import arm_of_section, checked_section, section_of_arm


def to_toml(document: dict[str, Any], text: str = "") -> str:
    """TOML text of plain values.

    Parameters
    ----------
    document : dict
        Of str, bool, int, float, dates, lists, and dicts (tables, nested at will).
    text : str
        TOML that the document was changed from: comments in it, and how its values are written, are kept.

    Returns
    -------
    text : str

    Raises
    ------
    CalibrationError
        TOML has no such value.
    """
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
    raise CalibrationError(f"A calibration file cannot hold such a value: {reason}.") from reason


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
#: Tables that tell a calibration without format and version, as people write it.
TABLES = ("arm", "camera_from_mocap", "camera_from_base", "imu", "forearm", "clock", "sigma")
#: Tables that are merged key by key, and how deep: an arm's lever arms by joint, a sensor's parts by key, the
#: held poses by side. A table below that depth, or any other, replaces the one of its name.
MERGED = {"arm": 3, "imu": 3, "forearm": 1}


@dataclass(frozen=True)
class CalibrationFile:
    """What a calibration file holds.

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
            raise CalibrationError(f"{self.source} holds no arm; add one with `unocclude calibrate forearm`.")
        if side in ("", "any"):
            if len(self.arms) == 1:
                return next(iter(self.arms.values()))
            raise CalibrationError(
                f"{self.source} holds both arms and the recording does not say which; give --side."
            )
        (other,) = self.arms
        raise CalibrationError(
            f"{self.source} holds the {other} arm only, and the recording is of the {side} arm; "
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
        It cannot be read, is no calibration or a newer one, or a value is wrong; the text names the key.
    """
    path = Path(path)
    document = _load(path)
    sections = document.get("arm", {})
    if not isinstance(sections, dict):
        raise CalibrationError(f"Calibration {path}: arm must be a table such as [arm.right].")
    for name in sections:
        if name not in SIDES:
            raise CalibrationError(f"Calibration {path}: arm.{name} is not one of {', '.join(SIDES)}.")
    arms = {
        side: arm_of_section(side, checked_section(section, f"arm.{side}", path))
        for side, section in sections.items()
    }
    tables = {name: value for name, value in document.items() if name not in ("format", "version", "arm")}
    for name, value in tables.items():
        if not isinstance(value, dict | list):
            raise CalibrationError(f"Calibration {path}: {name} is not a key that a calibration has.")
    return CalibrationFile(arms, tables, source=f"Calibration {path}")


def write_calibration(path: str | os.PathLike[str], calibration: CalibrationFile) -> None:
    """Write a calibration into a file, or merge it into the one that exists.

    Of an arm, what `calibration` states replaces what the file holds, lever arms joint by joint, and what it
    leaves open (None) is kept; so are other arms. A sensor's table is merged key by key, held poses side by
    side. Another table replaces the one of its name. Comments and what is not touched stay as they are. The
    file is replaced in one step: it is never seen half written.

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
    """A calibration as the text of its file, merged into the text that the file holds.

    Parameters
    ----------
    calibration : CalibrationFile
        What to write.
    path : Path
        The file, for messages.
    held : str
        Of a calibration that can be read; "" for a new file.

    Raises
    ------
    CalibrationError
        A value is wrong.
    """
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION} | tomllib.loads(held)
    for name in {"format", "version", "arm"} & set(calibration.tables):
        raise CalibrationError(f"Calibration {path}: a table of its own cannot be called {name}.")
    sections = {side: section_of_arm(arm) for side, arm in calibration.arms.items()}
    for side, section in sections.items():
        if side not in SIDES:
            raise CalibrationError(f"Calibration {path}: arm.{side} is not one of {', '.join(SIDES)}.")
        checked_section(section, f"arm.{side}", path)
    for name, table in (({"arm": sections} if sections else {}) | calibration.tables).items():
        document[name] = _merged(document.get(name), table, MERGED.get(name, 0))
    return to_toml(document, held)


def _merged(held: Any, new: Any, depth: int) -> Any:
    """What a table holds once another is merged into it, key by key to some depth."""
    if depth == 0 or not isinstance(held, dict) or not isinstance(new, dict):
        return new
    return {**held, **{key: _merged(held.get(key), value, depth - 1) for key, value in new.items()}}


def _load(path: Path) -> dict[str, Any]:
    """The file as plain values, once it has shown to be a calibration of a version that we know."""
    check_input(path, CalibrationError)
    try:
        document = read_toml(path)
    except OSError as error:
        raise CalibrationError(f"Calibration {path} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:  # also a number of thousands of digits
        raise CalibrationError(f"Calibration {path} is not TOML: {error}.") from error
    if document.get("format", FORMAT if set(TABLES) & set(document) else None) != FORMAT:
        raise CalibrationError(f'{path} is not a calibration: it lacks the line format = "{FORMAT}".')
    version = document.get("version", None if "format" in document else VERSION)
    if type(version) is not int or version < 1:
        raise CalibrationError(f"Calibration {path}: version must be a whole number such as {VERSION}.")
    if version > VERSION:
        raise CalibrationError(
            f"Calibration {path} has version {version} and this program knows versions up to {VERSION}; "
            "update unocclude."
        )
    return document


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
