"""APDM Opal: HDF5 of Mobility Lab, Moveo and Motion Studio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import crashes_in_subprocess
from ..tables.file_head import shown
from ..tables.imu_checks import size_notes
from ..tables.protocol import FileHead, ImuTable


class ApdmHdf:
    """Each sensor one IMU: m/s^2, rad/s, time in us since 1970.

    Layout: APDM, "HDF file format", version 5 (`/Sensors/<id>/Accelerometer`) and versions 1 to 4
    (`/<id>/Calibrated/Accelerometers`).
    """

    key = "apdm-hdf5"
    title = "APDM Opal HDF5"
    kind = "imu"
    recognised_by = "HDF5 with Sensors/<id>/Accelerometer or <id>/Calibrated/Accelerometers"

    def recognises(self, head: FileHead) -> bool:
        """Whether it is an HDF5 file; which one shows in reading. Never raises."""
        return head.raw[:8] == b"\x89HDF\r\n\x1a\n"

    def read(self, path: Path) -> list[ImuTable]:
        """A table a sensor: see `DeviceFormat.read`.

        Raises
        ------
        RecordingError
            The package h5py is absent, or the file holds no sensors.
        """
        try:
            import h5py
        except ImportError:
            raise RecordingError(
                f"{path} is HDF5, which is read by the library h5py; install it with: pip install h5py"
                " (or export CSV)."
            ) from None

        def read(file: Path) -> list[ImuTable]:
            with h5py.File(file, "r") as opened:
                return _sensors(opened)

        if crashes_in_subprocess(path, read):  # of damaged lengths HDF5 takes all memory
            raise RecordingError(f"{path} is a damaged HDF5 file; export it again.")
        try:
            tables = read(path)
        except (OSError, LookupError, ValueError, RuntimeError, TypeError, AttributeError) as error:
            raise RecordingError(f"{path} cannot be read as HDF5: {shown(str(error), 100)}.") from error
        if not tables:
            raise RecordingError(
                f"{path} holds no raw sensors of an Opal; export 'raw data' as HDF5, or CSV, from the APDM"
                " program."
            )
        for table in tables:
            table.notes += size_notes(table)
        return tables


def _sensors(file: Any) -> list[ImuTable]:
    if "Sensors" in file:
        groups = [(name, group, group) for name, group in file["Sensors"].items()]
    else:
        groups = [
            (name, group["Calibrated"], group) for name, group in file.items() if _has(group, "Calibrated")
        ]
    labels = _labels(file)
    tables = []
    for name, values, group in groups:
        acc, gyro, mag = (_vector(values, kind) for kind in ("Accelerometer", "Gyroscope", "Magnetometer"))
        if acc is None or gyro is None:
            continue
        time = np.asarray(group["Time"], dtype=float).ravel() if _has(group, "Time") else None
        count = min(len(values) for values in (acc, gyro, time) if values is not None)
        rate = group.attrs.get("SampleRate", file.attrs.get("SampleRate"))
        tables.append(
            ImuTable(
                name=_label(group) or labels.get(name, "") or name,
                t_s=None if time is None else time[:count] * 1e-6,
                acc=acc[:count],
                gyro=gyro[:count],
                mag=None if mag is None or len(mag) < count else mag[:count],
                rate_hz=None if rate is None else float(np.ravel(rate)[0]),
                units="m/s^2, rad/s",
            )
        )
    return tables


def _has(group: Any, key: str) -> bool:
    return hasattr(group, "keys") and key in group


def _vector(group: Any, kind: str) -> FloatArray | None:
    """A sensor's samples (N, 3), whether its name has a plural s or not."""
    for key in (kind, f"{kind}s"):
        if _has(group, key):
            values = np.asarray(group[key], dtype=float)
            values = values.T if values.ndim == 2 and values.shape[0] == 3 != values.shape[1] else values
            return values if values.ndim == 2 and values.shape[1] == 3 else None
    return None


def _label(group: Any) -> str:
    """What the wearer's place is called ("Right Wrist")."""
    if _has(group, "Configuration"):
        return _text(group["Configuration"].attrs.get("Label 0", ""))
    return _text(group.attrs.get("MonitorLabel", ""))


def _labels(file: Any) -> dict[str, str]:
    """What the wearer's places are called, by monitor (older versions)."""
    monitors, labels = (np.ravel(file.attrs.get(key, [])) for key in ("CaseIdList", "MonitorLabelList"))
    return {_text(monitor): _text(label) for monitor, label in zip(monitors, labels, strict=False)}


def _text(value: Any) -> str:
    return (value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)).strip("\0 ")
