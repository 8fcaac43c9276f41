"""Xsens MVN Analyze and Awinda: MVNX (XML) with raw sensors."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, iterparse

import numpy as np

from ...errors import RecordingError
from ..tables.file_head import shown
from ..tables.imu_checks import holds_gravity, size_notes
from ..tables.protocol import FileHead, ImuTable

_VALUES = ("sensorAcceleration", "sensorAngularVelocity", "sensorMagneticField")
_EXPORT = "export it again with sensor data 'acceleration' and 'angular velocity' (calibrated sensor data) on"


class Mvnx:
    """Sensors of a suit, each one IMU: m/s^2 and rad/s in the sensor's axes.

    Layout: MVN user manual, appendix on MVNX (`sensorAcceleration`, `sensorAngularVelocity`).
    """

    key = "mvnx"
    title = "Xsens MVNX"
    kind = "imu"
    recognised_by = "XML whose root is mvnx"

    def recognises(self, head: FileHead) -> bool:
        """Whether the XML's root is mvnx; never raises."""
        return bool(re.match(r"\s*(<\?xml.*?\?>\s*)?(<!--.*?-->\s*)*<mvnx\b", head.text[:4000], re.DOTALL))

    def read(self, path: Path) -> list[ImuTable]:
        """A table a sensor: see `DeviceFormat.read`.

        Raises
        ------
        RecordingError
            It is no sound XML, or holds no raw sensors.
        """
        rows: dict[str, list[str]] = {key: [] for key in _VALUES}
        names: list[str] = []
        times: list[str] = []
        rate, other = None, ""
        try:
            for event, element in iterparse(path, events=("start", "end")):
                tag = element.tag.rpartition("}")[2]
                if event == "start":
                    if tag == "subject":
                        rate = _number(element.get("frameRate"))
                    elif tag == "sensor":
                        names.append(element.get("label", ""))
                    continue
                if tag == "frame":
                    if element.get("type", "normal") == "normal":
                        other = _read_frame(element, rows, times) or other
                    element.clear()
        except ParseError as error:
            raise RecordingError(
                f"{path} is no sound MVNX: {shown(str(error), 80)}; export it again."
            ) from error
        except (OSError, ValueError) as error:
            raise RecordingError(f"{path} cannot be read as MVNX: {shown(str(error), 80)}.") from error
        return _tables(path, names, rows, times, rate, other)


def _read_frame(element: Element, rows: dict[str, list[str]], times: list[str]) -> str:
    """Take a frame's sensors; the name of free acceleration where that is all there is."""
    other = ""
    for child in element:
        tag = child.tag.rpartition("}")[2]
        if tag in rows:
            rows[tag].append(child.text or "")
        elif tag == "sensorFreeAcceleration":
            other = tag
    times.append(element.get("time", ""))
    return other


def _tables(
    path: Path,
    names: list[str],
    rows: dict[str, list[str]],
    times: list[str],
    rate: float | None,
    other: str,
) -> list[ImuTable]:
    if not rows["sensorAcceleration"] or not rows["sensorAngularVelocity"]:
        has = "free acceleration and orientation only" if other else "no raw sensors"
        raise RecordingError(f"{path} is an {Mvnx.title} that holds {has}; {_EXPORT}.")
    values = {}
    for key, texts in rows.items():
        if len(texts) != len(times):
            if key != "sensorMagneticField":
                raise RecordingError(f"{path} has {key} in {len(texts)} of {len(times)} frames; {_EXPORT}.")
            continue
        values[key] = _vectors(path, key, texts)
    acc, gyro, mag = (values.get(key) for key in _VALUES)
    assert acc is not None and gyro is not None
    count = acc.shape[1]
    if gyro.shape[1] != count:
        raise RecordingError(f"{path} has {count} accelerometers and {gyro.shape[1]} gyroscopes; {_EXPORT}.")
    if not holds_gravity(acc.reshape(-1, 3)):
        raise RecordingError(f"{path} holds acceleration without gravity; {_EXPORT}.")
    stamps = np.array([_number(text) or 0.0 for text in times]) * 1e-3
    stamped = bool((np.diff(stamps) > 0).any())
    tables = []
    for at in range(count):
        table = ImuTable(
            name=names[at] if at < len(names) else f"sensor {at + 1}",
            t_s=stamps.copy() if stamped else None,
            acc=acc[:, at],
            gyro=gyro[:, at],
            mag=None if mag is None or mag.shape[1] != count else mag[:, at],
            rate_hz=rate,
            units="m/s^2, rad/s",
        )
        table.notes += size_notes(table)
        tables.append(table)
    return tables


def _vectors(path: Path, key: str, texts: list[str]) -> np.ndarray:
    """Vectors of all sensors, shape (frames, sensors, 3)."""
    lengths = {text.count(" ") for text in map(str.strip, texts)}
    try:
        values = np.array(" ".join(texts).split(), dtype=float).reshape(len(texts), -1, 3)
    except ValueError:
        raise RecordingError(
            f"{path}: {key} is not three numbers a sensor in every frame; export it again."
        ) from None
    if len(lengths) > 1 and len({len(text.split()) for text in texts}) > 1:
        raise RecordingError(f"{path}: {key} has unequally many numbers in its frames; export it again.")
    return values


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) else None
