"""MCAP recordings, to be put together with other files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...errors import RecordingError
from ...recording import JOINTS
from ..mcap.stamps import seconds
from ..recording.read import open_recording
from ..recording.streams import ArmFrames
from .head import shown
from .protocol import FileHead, ImuTable, SkeletonTable


@dataclass(frozen=True)
class McapFile:
    """IMUs and arms of an MCAP file, as `unocclude smooth` reads them too.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "mcap"
    title: str = "MCAP recording"
    kind: str = "recording"
    recognised_by: str = "MCAP's first bytes"

    def recognises(self, head: FileHead) -> bool:
        """Whether the file begins as MCAP files do."""
        return head.raw.startswith(b"\x89MCAP0\r\n")

    def read(self, path: Path) -> list[ImuTable | SkeletonTable]:
        """Read all IMUs and bodies.

        Raises
        ------
        RecordingError
            The file is damaged, or holds neither.
        """
        file = open_recording(path, truth=False)
        by_body: dict[tuple[str, int], list[ArmFrames]] = {}
        for arm in file.arms:
            by_body.setdefault((arm.topic, arm.body), []).append(arm)
        tables: list[ImuTable | SkeletonTable] = [_skeleton(arms) for arms in by_body.values()]
        tables += [
            ImuTable(
                imu.topic.strip("/"),
                seconds(imu.stamp_ns, 0),
                imu.acc,
                imu.gyro,
                imu.mag,
                units="m/s^2, rad/s",
            )
            for imu in file.imus
        ]
        if not tables:
            listed = ", ".join(f"{topic.name} ({topic.schema}, {topic.encoding})" for topic in file.topics)
            raise RecordingError(
                f"{path} holds no IMU and no skeleton that can be read (topics:"
                f" {shown(listed or 'none', 150)});"
                " record sensor_msgs/Imu and the body tracking's MarkerArray."
            )
        tables[0].notes += file.notes
        for table in tables:
            if isinstance(table, SkeletonTable) and file.camera_frame is not None:
                table.frame = file.camera_frame
            if isinstance(table, SkeletonTable) and file.gravity_hint is not None:
                table.gravity_hint = file.gravity_hint
        return tables


def _skeleton(arms: list[ArmFrames]) -> SkeletonTable:
    """One body of the arms that it has."""
    first = arms[0]
    table = SkeletonTable(first.body, seconds(first.stamp_ns, 0), {}, {}, first.camera_frame, units="m")
    for arm in arms:
        for at, joint in enumerate(JOINTS):
            if (arm.state[:, at] != 0).any():
                name = f"{joint}_{arm.side}" if arm.side else joint
                table.position[name], table.state[name] = arm.position[:, at], arm.state[:, at]
    return table
