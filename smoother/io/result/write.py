"""A recovery to an MCAP file that Foxglove and Rerun show as it is; every column of it as Parquet tables."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...errors import UnoccludeError
from ...result import Recovery, arm_tags
from ...result.columns import SAMPLES
from ...runtime.outputs import check_output, writing
from ..mcap.container import Container
from ..mcap.merge import Output, OutputStream
from ..mcap.messages import damage, nanoseconds
from ..recording.read import METADATA, open_recording
from ..recording.streams import RecordingFile
from ..recording.write import CAMERA
from ..wire.layout import Buffer
from .streams import common_down, recovery_streams

Columns = dict[str, NDArray]
#: Rows that are written together: what passes through the memory.
_ROWS = 4_000
#: Drawn motions are rounded to this many parts of a metre, which is 8 micrometres, and of a radian.
_PARTS = 2.0**17
#: Columns of segments and of the trunk by the names of their attributes.
SEGMENT, TRUNK = ("position", "quaternion", "pose_covariance"), ("quaternion", "covariance")


def tables_of(recovery: Recovery) -> dict[str, Columns]:
    """The tables; what is of a joint or a segment stands behind its name and a slash."""
    r, origin = recovery, recovery.origin_ns
    samples = {"stamp_ns": nanoseconds(r.t_s, origin), **{name: getattr(r, name) for name in SAMPLES}}
    for joint, position in r.joints.items():
        samples |= {f"{joint}/position": position, f"{joint}/covariance": r.joint_covariance[joint]}
    for name, motion in r.segments.items():
        samples |= {f"{name}/{column}": getattr(motion, column) for column in SEGMENT}
    if r.trunk is not None:
        samples |= {f"trunk/{column}": getattr(r.trunk, column) for column in TRUNK}
    frames = {"stamp_ns": nanoseconds(r.arm.t_s, origin), "position": r.arm.position, "state": r.arm.state}
    tables = {"samples": samples, "frames": frames}
    if (residuals := r.residuals) is not None:
        columns = {name: getattr(residuals, name) for name in ("residual", "used", "reason")}
        tables["residuals"] = {"stamp_ns": nanoseconds(residuals.t_s, origin), **columns}
    if (draws := r.draws) is not None:
        drawn = {name: np.moveaxis(values, 0, 1) for name, values in draws.columns().items()}
        tables["draws"] = {"stamp_ns": nanoseconds(draws.t_s, origin), **drawn}
    return tables


def rounded(drawn: NDArray) -> NDArray:
    """Drawn motions as files have them: numbers of one size shrink best."""
    return np.rint(drawn * _PARTS).astype(np.float32) / np.float32(_PARTS)


def write_table(columns: Columns, file: IO[bytes]) -> None:
    """Write columns (n, ..); in the file a row of one is a list, and its shape stands beside it."""
    import pyarrow as pa
    from pyarrow import parquet

    def part(rows: slice) -> pa.Table:
        arrays, fields = [], []
        for name, values in columns.items():
            some = values[rows]
            some = rounded(some) if values.dtype == np.float32 else some
            array = pa.array(np.ascontiguousarray(some).reshape(-1))
            if values.ndim > 1:
                array = pa.FixedSizeListArray.from_arrays(array, int(np.prod(values.shape[1:])))
            arrays.append(array)
            fields.append(pa.field(name, array.type, metadata={"shape": json.dumps(values.shape[1:])}))
        return pa.Table.from_arrays(arrays, schema=pa.schema(fields))

    split = [f"{name}.list.element" if v.ndim > 1 else name for name, v in columns.items() if v.itemsize > 2]
    how = {"compression": "zstd", "compression_level": 1, "use_dictionary": False, "write_statistics": False}
    schema = part(slice(0, 0)).schema
    with parquet.ParquetWriter(file, schema, use_byte_stream_split=split, **how) as writer:
        for start in range(0, len(columns["stamp_ns"]), _ROWS):
            writer.write_table(part(slice(start, start + _ROWS)))


def read_table(data: Buffer) -> Columns:
    """What `write_table` wrote."""
    import pyarrow as pa
    from pyarrow import parquet

    file = parquet.ParquetFile(pa.BufferReader(pa.py_buffer(data)))
    columns = {}
    for field in file.schema_arrow:
        shape = json.loads(field.metadata[b"shape"])
        values = file.read([field.name])[field.name].combine_chunks()
        flat = values.flatten() if shape else values
        columns[field.name] = np.array(flat.to_numpy(zero_copy_only=False)).reshape(-1, *shape)
    return columns


RESULT = "unocclude.result"
PARQUET = "application/vnd.apache.parquet"


def write_recovery(
    recoveries: Recovery | Sequence[Recovery],
    path: str | os.PathLike[str],
    *,
    source: str | os.PathLike[str] | None = None,
    force: bool = False,
) -> None:
    """Write the recovered motion of one arm, or of several, to an MCAP file.

    Attachments are Parquet tables with every column: `unocclude.result/samples.parquet` (the IMU's
    samples), and `frames`, `residuals` and `draws`. The metadata record `unocclude.result` contains all
    else as JSON; `read_recovery` gives everything back. Topics are for viewers, at the camera's rate:
    `/unocclude/forearm` (Odometry: pose of the IMU in the camera frame, velocity in its own axes; an
    answer without orientation has body_frame_id = frame_id), `/unocclude/skeleton` (joints with
    covariance), `/unocclude/arm` and `/unocclude/arm_camera` (drawn after and before, orange where
    occluded, dark red where the answer is not to be trusted), `/unocclude/beads` (PointCloud along the
    bones), `/unocclude/gaps` (Event, with `trusted` and `reasons` in its metadata), `/unocclude/log`
    (Log: the gaps), `/unocclude/joints` (JointStates: elbow_flexion, rad, 0 = straight), `/unocclude/tf`
    (FrameTransforms: camera to forearm IMU, and the level `world` to the camera), `/unocclude/camera`
    (the camera's joints on the IMU's clock). With several arms each name ends in the arm's side, with
    several people in `body_N/SIDE` (`result.arm_tags`). The same input gives the same bytes.

    Parameters
    ----------
    recoveries : Recovery or sequence of Recovery
        One arm's recovery, or several of one recording.
    path : path-like
        The file to write.
    source : path-like, optional
        The recording: frames are called as there, and its camera's axes are kept.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, it is the recording itself, or it cannot be written.
    """
    results = [recoveries] if isinstance(recoveries, Recovery) else list(recoveries)
    check_output(path, force)
    if source is not None and os.path.exists(path) and os.path.samefile(source, path):
        raise UnoccludeError(f"{path} is the recording itself; give another name to write to.")
    frames: dict[str, str] = {}
    about: dict[str, str] = {}
    shift = 0
    level_down = None
    if source is not None:
        recorded = open_recording(source, only={recovery.arm.name for recovery in results})
        about = _about(recorded)
        frames = {arm.topic: arm.frame_id for arm in recorded.arms if arm.frame_id}
        level_down = recorded.level_down
        shift = recorded.imus[0].log_shift_ns if recorded.imus else 0
        # A recorder's delay is not a reason to move; a sensor that counts from its own start is.
        shift = shift if abs(shift) > 1_000_000_000 else 0
    down = common_down(results, level_down)
    with writing(path, force) as temporary, Output(temporary) as output:
        streams: list[OutputStream] = []
        for tag, recovery in zip(arm_tags(results), results, strict=True):
            suffix = "" if len(results) == 1 else f"/{tag}"
            output.metadata(RESULT + suffix, recovery_values(recovery, __version__))
            for table, columns in tables_of(recovery).items():  # through a file, not through the memory
                with tempfile.TemporaryFile(dir=temporary.parent) as file:
                    write_table(columns, file)
                    output.attachment(f"{RESULT}{suffix}/{table}.parquet", file, PARQUET)
            frame_id = frames.get(recovery.arm.name, CAMERA)
            streams += recovery_streams(output, recovery, suffix, frame_id, shift, down)
        if about:
            output.metadata(METADATA, about)
        output.write(streams)


def _about(file: RecordingFile) -> dict[str, str]:
    """The recording's metadata, wherever in the file it stands, and the camera's axes."""
    implied = next((arm.camera_frame for arm in file.arms if arm.camera_frame is not None), None)
    axes = {} if implied is None else {"camera_frame": str(implied)}
    return axes | Container(file.path).skimmed().metadata.get(METADATA, {})


def to_json(value: object) -> str:
    """JSON of plain values, arrays (as lists) and dataclasses; nan stays nan, as Python reads it."""
    text = json.dumps(value, default=_plain, ensure_ascii=False)
    return text.encode("utf-8", "backslashreplace").decode("utf-8")  # a file's name may be no UTF-8: \\udcff


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return vars(value)
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, set | frozenset):
        return sorted(value)
    return str(value)


#: What a result's metadata states by the names of the attributes.
STATED = (
    *("method", "name", "side", "body", "origin_ns", "gaps", "calibration", "gravity_direction"),
    *("clock_offset_s", "clock_offset_sigma_s", "notes"),
)


def recovery_values(recovery: Recovery, version: str) -> dict[str, str]:
    """The metadata record of a result: JSON by key."""
    trunk, draws, residuals = recovery.trunk, recovery.draws, recovery.residuals
    values = {name: getattr(recovery, name) for name in STATED}
    values |= {
        "version": version,
        "camera": recovery.arm.name,
        "config": _lasting(recovery.config),
        "figures": recovery.estimates.plain(),
        "joints": list(recovery.joints),
        "segments": {name: _without(motion, SEGMENT) for name, motion in recovery.segments.items()},
        "trunk": None if trunk is None else _without(trunk, TRUNK),
        "draws": None if draws is None else {"count": len(draws), "seed": draws.seed},
        "damage": damage(recovery.notes),
        "rejected_for": None if residuals is None else [reason.sentence for reason in residuals.reasons],
    }
    return {key: to_json(value) for key, value in values.items()}


def _without(value: object, columns: Sequence[str]) -> dict[str, object]:
    return {name: each for name, each in vars(value).items() if name not in columns}


def _lasting(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration without the number of processes: it does not affect the result."""
    return {
        section: {key: value for key, value in settings.items() if (section, key) != ("windows", "processes")}
        if isinstance(settings, Mapping)
        else settings
        for section, settings in config.items()
    }
