"""A recovery back from the MCAP file that `write_recovery` made."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from ...errors import RecordingError
from ...measurements.visibility import Reason
from ...recording import JointTracks
from ...result import Draws, Estimates, FrameResiduals, Recovery, SegmentMotion, TrunkMotion
from ...result.columns import SAMPLES
from ..mcap.container import Container
from ..mcap.messages import DamageNote, plain_name, seconds, told_behind
from ..recording.read import METADATA
from .write import RESULT, SEGMENT, STATED, TRUNK, Columns, read_table

#: What values of a result that somebody else wrote, or that are damaged, end in.
BROKEN_RESULT = (
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    IndexError,
    ArithmeticError,
    AssertionError,
    RecursionError,
    ImportError,
)


def read_recovery(path: str | os.PathLike[str]) -> list[Recovery]:
    """Read the recovered motion from a result file: a list with one `Recovery` for each arm in it.

    Parameters
    ----------
    path : path-like
        A file of `write_recovery`.

    Returns
    -------
    list of Recovery
        One for each arm, also where the file contains one arm only: ``[recovery] = read_recovery(path)``.
        Each is as it was written, times to the nanosecond and drawn motions to 8 micrometres. Arrays in
        `estimates.further` come back as lists.

    Raises
    ------
    RecordingError
        The file is missing, damaged, or has no result.
    """
    container = Container(path).skimmed()
    names = [name for name in container.metadata if name.partition("/")[0] == RESULT]
    if not names:
        raise RecordingError(f"{path} has no result; make one with `unocclude smooth REC.mcap -o OUT.mcap`.")
    return [_recovery(Path(path), container, name) for name in names]


def stated_estimates(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, Estimates]:
    """What each arm of a result states besides its motion."""
    found = {}
    for name, values in metadata.items():
        if name.partition("/")[0] == RESULT:
            with suppress(*BROKEN_RESULT):
                found[name.removeprefix(RESULT).lstrip("/")] = Estimates.from_plain(
                    json.loads(values["figures"])
                )
    return found


def read_origin(path: str | os.PathLike[str]) -> tuple[str, str]:
    """The version that wrote a result, and the recording's title; "" where not stated."""
    container = Container(path).skimmed()
    version = ""
    for name, values in container.metadata.items():
        if name.partition("/")[0] == RESULT:
            with suppress(*BROKEN_RESULT):
                version = restored(str, json.loads(values["version"]))
    title = container.metadata.get(METADATA, {}).get("name", "")
    return version, title


def _recovery(path: Path, container: Container, name: str) -> Recovery:
    label = plain_name(name.removeprefix(RESULT))
    try:
        values: dict[str, Any] = {key: json.loads(text) for key, text in container.metadata[name].items()}
        if not container.notes and not any(each.startswith(f"{name}/") for each in container.attachments):
            raise RecordingError(
                f"{path} is a result of version {values['version']}; results from before 1.0 are not read."
                " Run `unocclude smooth` again."
            )
        tables = {
            table: read_table(container.attachment(f"{name}/{table}.parquet"))
            for table in ("samples", "frames", "residuals", "draws")
            if table in ("samples", "frames") or f"{name}/{table}.parquet" in container.attachments
        }
        return _assembled(values, tables, tuple(container.notes))
    except BROKEN_RESULT as error:
        why = f"{type(error).__name__} {plain_name(str(error))}"
        raise RecordingError(
            f"{path}: its result{label} is damaged or of another version ({why}); "
            f"run `unocclude smooth` again.{told_behind(container.notes)}"
        ) from error


def _assembled(values: dict[str, Any], tables: dict[str, Columns], notes: tuple[str, ...]) -> Recovery:
    hints, samples, frames = get_type_hints(Recovery), tables["samples"], tables["frames"]
    stated = {name: restored(hints[name], values[name]) for name in STATED}
    origin, seeds = stated["origin_ns"], values["draws"]
    of_files = values["damage"]
    stated["notes"] = (
        tuple(DamageNote(note) if note in of_files else note for note in stated["notes"]) + notes
    )
    residuals, draws = None, None
    if (reasons := values["rejected_for"]) is not None:
        columns = tables["residuals"]
        told = tuple(Reason.of_sentence(sentence) for sentence in reasons)
        residuals = FrameResiduals(seconds(columns.pop("stamp_ns"), origin), **columns, reasons=told)
    if seeds is not None:
        columns = tables["draws"]
        t_s = seconds(columns.pop("stamp_ns"), origin)
        drawn = {name: np.moveaxis(values, 1, 0) for name, values in columns.items()}
        draws = Draws.from_columns(t_s, int(seeds["seed"]), drawn)
    segments = {
        name: restored(SegmentMotion, own | _of(samples, name, SEGMENT))
        for name, own in values["segments"].items()
    }
    trunk = values["trunk"]
    motion: dict[str, Any] = {name: samples[name] for name in SAMPLES}
    return Recovery(
        **stated,
        **motion,
        t_s=seconds(samples["stamp_ns"], origin),
        joints={joint: samples[f"{joint}/position"] for joint in values["joints"]},
        joint_covariance={joint: samples[f"{joint}/covariance"] for joint in values["joints"]},
        arm=JointTracks(
            values["camera"], seconds(frames["stamp_ns"], origin), frames["position"], frames["state"]
        ),
        residuals=residuals,
        config=restored(dict, values["config"]),
        estimates=Estimates.from_plain(values["figures"]),
        segments=segments,
        trunk=None if trunk is None else restored(TrunkMotion, trunk | _of(samples, "trunk", TRUNK)),
        draws=draws,
    )


def _of(samples: Columns, name: str, columns: tuple[str, ...]) -> Columns:
    return {column: samples[f"{name}/{column}"] for column in columns}


def restored(hint: Any, value: Any) -> Any:
    """A value of a type from its JSON; TypeError where it is of another."""
    kinds, kind = get_args(hint), get_origin(hint) or hint
    if kind is UnionType:
        (one,) = (each for each in kinds if each is not NoneType)
        return None if value is None else restored(one, value)
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        return kind(**{name: restored(hints[name], each) for name, each in value.items()})  # type: ignore[operator]
    if kind is np.ndarray:
        return np.asarray(value, float) if isinstance(value, list) else value
    if kind is dict and kinds:
        return {name: restored(kinds[1], each) for name, each in value.items()}
    if kind is tuple:
        return tuple(restored(kinds[0], each) for each in value)
    if kind is float and isinstance(value, int):
        return float(value)
    if not isinstance(value, kind):
        raise TypeError(f"{kind.__name__} expected, not {type(value).__name__}")
    return value
