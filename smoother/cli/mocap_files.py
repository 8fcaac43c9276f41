"""The files of a simulated motion capture, beside its recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..simulation import MarkerCapture

_MAP_HEAD = """# Markers of {name}: the mean of a joint's markers is its centre. The plate on the IMU is
# rigid; its mean is the IMU, and [imu_plate] says where its markers are in the IMU's axes, m.
# Use: unocclude validate OUT.mcap --truth {name} --markers {map} --calibration {calibration}
"""


@dataclass(frozen=True)
class MocapFiles:
    """Names of what a motion capture is written to.

    Attributes
    ----------
    c3d, trc : Path
        The markers, alike.
    map : Path
        Which markers make a joint.
    calibration : Path
        Where [camera_from_mocap] goes if no other file is named.
    """

    c3d: Path
    trc: Path
    map: Path
    calibration: Path

    @classmethod
    def beside(cls, recording: Path, calibration: Path | None) -> MocapFiles:
        """The names that belong to a recording's; the calibration's may be given."""

        def name(ending: str) -> Path:
            return recording.with_name(f"{recording.stem}{ending}")

        return cls(
            name(".c3d"), name(".trc"), name("_markers.toml"), calibration or name("_calibration.toml")
        )

    @property
    def markers(self) -> tuple[Path, Path, Path]:
        """All but the calibration."""
        return self.c3d, self.trc, self.map

    def write(self, capture: MarkerCapture, force: bool) -> None:
        """Write the capture as a lab would: its own frame and clock, millimetres, blanks where not seen."""
        from calib.file import to_toml

        from ..io.export.markers import C3dContent, write_c3d, write_trc
        from ..runtime.outputs import writing

        write_c3d(self.c3d, C3dContent(capture.names, capture.position, capture.rate_hz), force)
        write_trc(self.trc, capture.names, capture.t_s, capture.position, capture.rate_hz, force)
        head = _MAP_HEAD.format(name=self.c3d.name, map=self.map.name, calibration=self.calibration.name)
        text = head + "\n" + to_toml({"markers": capture.marker_map, "imu_plate": capture.plate})
        with writing(self.map, force) as temporary:
            temporary.write_text(text, encoding="utf-8")
