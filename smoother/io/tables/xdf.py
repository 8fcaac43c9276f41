"""XDF of the Lab Streaming Layer: streams whose channels are a sensor's axes or joints."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...recording import CameraFrame
from .imu import (
    Columns,
    ImuTable,
    channel_labels,
    find_sensors,
    stem_of,
    unit_of,
    with_halves_joined,
)
from .joints import find_joint_columns, has_arm, program_of
from .skeletons import Conventions, RawSkeleton, SkeletonTable
from .table import Format, begins, shown
from .units import ACCELERATION, ANGULAR_VELOCITY, METRES, plain_unit

#: What is larger is not a measurement in any unit.
_DAMAGED = 1e9


@dataclass(frozen=True)
class _Stream:
    """One stream with numbers."""

    name: str
    kind: str
    rate_hz: float | None
    labels: list[str]
    types: list[str]
    units: list[str]
    t_s: np.ndarray
    values: np.ndarray


def read_xdf(path: Path) -> list[ImuTable | SkeletonTable]:
    """Streams whose channels' labels are a sensor's axes or joints; the file's clock offsets are applied."""
    import pyxdf

    logger = logging.getLogger("pyxdf")  # its warnings stay off the terminal
    logger.propagate, logger.handlers = False, [logging.NullHandler()]
    loaded, _ = pyxdf.load_xdf(str(path), dejitter_timestamps=False, verbose=False)
    streams = [stream for entry in loaded if (stream := _stream(entry)) is not None]
    skeletons = [table for stream in streams for table in _xdf_skeletons(stream, path)]
    imus, reasons = _imus(streams, path)
    if not skeletons and not imus:
        listed = (
            "; ".join(f"{s.name} ({s.kind}, {len(s.labels)} channels)" for s in streams)
            or "none with numbers"
        )
        why = f"; {reasons[0]}" if reasons else ""
        raise RecordingError(
            f"{path} has no stream of an accelerometer, a gyroscope or joints by its channels' labels"
            f" (streams: {shown(listed, 150)}{why}); stream them with labels such as acc_x, gyro_x,"
            " WristRight_X and units."
        )
    for reason in reasons:
        (imus or skeletons)[0].notes.append(f"A stream was left out: {reason}.")
    for number, table in enumerate(skeletons):
        table.body = number if len({other.body for other in skeletons}) < len(skeletons) else table.body
    return [*skeletons, *imus]


XDF = Format(
    "xdf",
    "XDF recording (Lab Streaming Layer)",
    "recording",
    "the first bytes XDF:",
    begins(b"XDF:"),
    read_xdf,
)


def _stream(entry: dict[str, Any]) -> _Stream | None:
    """A stream with numbers and stamps; None for markers in words, and for what is empty."""
    info, values = entry.get("info", {}), entry.get("time_series")
    t_s = np.asarray(entry.get("time_stamps", ()), dtype=float)
    if not isinstance(values, np.ndarray) or values.ndim != 2 or len(t_s) != len(values) or len(t_s) < 2:
        return None
    if values.dtype.kind not in "fiu" or values.shape[1] < 3:
        return None
    try:
        channels = [dict(channel) for channel in info["desc"][0]["channels"][0]["channel"]]
    except (KeyError, IndexError, TypeError, ValueError):
        channels = []
    channels = (channels + [{}] * values.shape[1])[: values.shape[1]]
    labels, types, units = channel_labels(partial(_text, channel) for channel in channels)
    rate = 0.0
    with suppress(ValueError):
        rate = float(_text(info, "nominal_srate"))
    rate_hz = rate if 0 < rate < 1e5 else None
    return _Stream(_text(info, "name"), _text(info, "type"), rate_hz, labels, types, units, t_s, values)


def _text(entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    value = value[0] if isinstance(value, list) and value else value
    return str(value) if isinstance(value, str | int | float) else ""


def _xdf_skeletons(stream: _Stream, path: Path) -> list[SkeletonTable]:
    """Bodies of a stream whose labels name joints."""
    columns = find_joint_columns(stream.labels)
    if not has_arm(columns.axes):
        return []
    values = stream.values.astype(float)
    raw = RawSkeleton(path, time=stream.t_s, time_unit="s")
    raw.add_columns(columns, lambda at: values[:, at], lambda at: values[:, at])
    raw.notes.append(f"Joints are of the stream {stream.name} ({stream.kind}).")
    if columns.body is not None and (body := values[:, columns.body] > 0).any():
        raw.body = np.where(body, values[:, columns.body], np.nan)
    frames = {"azure": CameraFrame.OPTICAL, "kinect": CameraFrame.KINECT}
    stated = METRES.get(stream.units[next(iter(columns.axes.values()))[0]].strip().lower())
    unit = next((unit for unit in ("m", "cm", "mm") if METRES[unit] == stated), "")
    return raw.skeletons(Conventions(unit, frames.get(program_of(stream.labels))))


def _imus(streams: list[_Stream], path: Path) -> tuple[list[ImuTable], list[str]]:
    """Sensors of all streams, and why some were left out; halves of a sensor are put together."""
    whole: list[ImuTable] = []
    halves: list[ImuTable] = []
    reasons: list[str] = []
    for stream in streams:
        if has_arm(find_joint_columns(stream.labels).axes):
            continue
        sensors = find_sensors(stream.labels, stream.types, f"{stream.name} {stream.kind}")
        for name, axes in sensors.items():
            table, why = _imu(stream, "_".join(filter(None, (stream.name, name.replace(" ", "_")))), axes)
            if why:
                reasons.append(why)
            else:
                (halves if table.acc is None or table.gyro is None else whole).append(table)
    joined, _, alone = with_halves_joined(halves, str(path))
    for table in joined:
        table.name = stem_of(table.name).replace(" ", "_") or "imu"
    return whole + joined, reasons + alone


def _imu(stream: _Stream, name: str, axes: dict[str, Columns]) -> tuple[ImuTable, str]:
    """A sensor's samples in SI units; or why its units are not known."""
    values = np.where(np.abs(stream.values) < _DAMAGED, stream.values, np.nan)
    vectors = {kind: values[:, columns].astype(float) for kind, columns in axes.items()}
    table = ImuTable(name, stream.t_s, None, None, vectors.get("mag"), stream.rate_hz)
    units = []
    for kind, known in (("acc", ACCELERATION), ("gyro", ANGULAR_VELOCITY)):
        if kind not in vectors:
            continue
        stated = stream.units[axes[kind][0]]
        unit, why = unit_of(kind, vectors[kind], stated, "", table.acc, table.t_s, table.rate_hz)
        if not unit or (not why and unit == "rad/s"):
            return table, f"{name}: the unit of {kind} is not stated, and the motion does not show it"
        if plain_unit(stated) not in known:
            table.notes.append(f"{name}: assumed {unit} for {kind} ({why or 'it is too fast in rad/s'}).")
        setattr(table, kind, vectors[kind] * known[unit])
        units.append(unit)
    table.units = ", ".join(units)
    return table, ""
