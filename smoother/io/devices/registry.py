"""The table of importers, and which of them a file belongs to."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from ...errors import RecordingError
from .head import first_rows, no_table
from .missing_axes import missing_axes, missing_axes_words
from .protocol import DeviceFormat, FileHead
from .table_layout import layout_of

#: "module:Class" of every importer, a line each; where two recognise a file, the upper one has it.
FORMATS: tuple[str, ...] = (
    "xdf:XdfFile",
    "rosbag1:RosBag1",
    "mcap_file:McapFile",
    "joint_array:JointArray",
    "c3d:C3dSkeleton",
    "trc:TrcSkeleton",
    "kinect_json:KinectJson",
    "pose_json:PoseJson",
    "azure_kinect:AzureKinectTable",
    "kinect_v2:KinectV2Table",
    "mediapipe:MediapipeTable",
    "named_joints:NamedJoints",
    "long_skeleton:LongSkeleton",
    "bare_kinect:BareKinect",
    "xsens_mt:XsensMt",
    "xsens_dot:XsensDot",
    "mvnx:Mvnx",
    "shimmer:Shimmer",
    "apdm:Apdm",
    "apdm_hdf:ApdmHdf",
    "ximu:Ximu",
    "nilspod:NilsPod",
    "metamotion:MetaMotion",
    "sensorlog:SensorLog",
    "phyphox:Phyphox",
    "axivity:Axivity",
    "android:AndroidLog",  # behind the others: its columns are the least particular
)


@cache
def formats() -> tuple[DeviceFormat, ...]:
    """All importers, in the order of the table."""
    importers = []
    for entry in FORMATS:
        module, _, name = entry.partition(":")
        importers.append(getattr(import_module(f".{module}", __package__), name)())
    return tuple(importers)


def format_named(key: str) -> DeviceFormat:
    """The importer of that key.

    Parameters
    ----------
    key : str
        As `unocclude import formats` lists it.

    Raises
    ------
    RecordingError
        There is none of that name; the message lists them.
    """
    for importer in formats():
        if importer.key == key.strip().lower():
            return importer
    raise RecordingError(
        f"{key} is no format; formats are {', '.join(importer.key for importer in formats())}."
    )


def recognise(head: FileHead, kinds: tuple[str, ...] = ()) -> DeviceFormat | None:
    """The importer that a file belongs to, by what is in it.

    Parameters
    ----------
    head : FileHead
        The file's beginning.
    kinds : tuple of str
        Importers of these kinds come first ("imu", "skeleton", "recording").

    Returns
    -------
    DeviceFormat or None
        None where no importer recognises it.
    """
    for importer in formats():
        if (not kinds or importer.kind in kinds) and importer.recognises(head):
            return importer
    for importer in formats() if kinds else ():
        if importer.kind not in kinds and importer.recognises(head):
            return importer
    return None


def unknown_file(head: FileHead) -> RecordingError:
    """The sentence about a file that no importer recognises."""
    if what := no_table(head.raw, head.text):
        return RecordingError(f"{head.path} {what}")
    return RecordingError(
        f"{head.path} is of no known format{_lacking(head)}; it begins with: {first_rows(head)}. Known are"
        f" {keys()} (`unocclude import formats`); for any other table `unocclude import describe {head.path}`"
        " prints a recording.toml."
    )


def _lacking(head: FileHead) -> str:
    layout = layout_of(head.lines) if head.text else None
    missing = [] if layout is None else missing_axes(layout.names)
    return f" (it has {missing_axes_words(missing)})" if missing else ""


def keys() -> str:
    """Keys of all importers, for messages."""
    return ", ".join(importer.key for importer in formats())
