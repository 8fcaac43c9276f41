"""The local page as a browser asks it, and sessions as files that devices export."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from imu_files import rows
from starlette.testclient import TestClient

from smoother.app.folder import AppFolder, write_json
from smoother.app.steps import STREAMS
from smoother.io.registry import FileReader
from smoother.io.tables.describe import describe_files
from smoother.io.tables.recording_toml import read_templates
from smoother.recording import JOINTS
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.units import STANDARD_GRAVITY

DAY_S = 86_400.0
#: 12 March 2026, when the sessions were.
START_S = 1_773_300_000.0
PORT, TOKEN = 8123, "secret-token"
HOST = f"http://127.0.0.1:{PORT}"


@dataclass
class Page:
    """What a browser with the page open does."""

    client: TestClient
    folder: AppFolder
    headers: dict[str, str] = field(default_factory=lambda: {"origin": HOST})

    def ask(self, method: str, path: str, code: int = 200, **more: Any) -> dict[str, Any]:
        answer = self.client.request(method, path, headers=self.headers, **more)
        assert answer.status_code == code, (method, path, answer.status_code, answer.text[:500])
        return answer.json() if answer.headers["content-type"] == "application/json" else {}

    def add(self, files: list[Path], name: str = "Session", job: bool = False) -> str:
        """A recording of files, copied and looked at: in this process, or by a job."""
        made: str = self.ask("POST", "/api/recordings", json={"name": name})["id"]
        for file in files:
            self.ask("PUT", f"/api/recordings/{made}/files/{file.name}", content=file.read_bytes())
        self.look(made, job)
        return made

    def look(self, name: str, job: bool = False) -> None:
        """Look at a recording's files."""
        if job:
            self.begin(name, "describe")
            self.wait(name)
            return
        place = self.folder.of(name)
        reader = FileReader(templates=read_templates(self.folder.template_files()))
        found = [asdict(each) for each in describe_files([place / "files"], reader)]
        for each in found:
            each["file"] = f"files/{Path(each['file']).name}"
        write_json(place / STREAMS, {"files": found})

    def begin(self, name: str, kind: str, **more: Any) -> dict[str, Any]:
        return self.ask("POST", f"/api/recordings/{name}/jobs", json={"kind": kind, **more})

    def change(self, name: str, **wish: Any) -> dict[str, Any]:
        revision = self.ask("GET", f"/api/recordings/{name}")["revision"]
        return self.ask("PATCH", f"/api/recordings/{name}", json={"revision": revision, **wish})

    def wait(self, name: str, until: tuple[str, ...] = (), patience_s: float = 120.0) -> dict[str, Any]:
        """Wait until a recording's job is over (or in a state), and what is known then."""
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            about = self.ask("GET", f"/api/recordings/{name}")
            job = about["job"]
            if job is None or job["state"] in until or not job["open"]:
                return about
            time.sleep(0.05)
        raise AssertionError(f"still {about['job']}")


def write_session(
    folder: Path, start_s: float = 0.0, mirror: bool = False, repetitions: int = 2
) -> dict[str, Path]:
    """An arm with gaps, 16 s a repetition: a table of joints, and what Shimmer's Consensys exports of an IMU.

    They start so many seconds after 12 March 2026; the skeleton's x may have the other sign.
    """
    folder.mkdir(parents=True)
    recording = simulate_arm(ArmSimulation.preset("realistic", repetitions=repetitions), seed=5).recording
    imu, arm, began_s = recording.imu, recording.arm, START_S + start_s
    sensor, kinect = folder / "shimmer.csv", folder / "kinect.csv"
    heads = ["S_Timestamp_Unix_CAL", *(f"S_Accel_WR_{axis}_CAL" for axis in "XYZ")]
    heads += [f"S_Gyro_{axis}_CAL" for axis in "XYZ"]
    body = rows(1e3 * (imu.t_s + began_s), imu.acc / STANDARD_GRAVITY, np.degrees(imu.gyro), form="{:.7f}")
    lines = ['"sep=,"', ",".join(heads), ",".join(["ms", *["g"] * 3, *["deg/s"] * 3]), *body]
    sensor.write_text("\n".join(lines) + "\n", encoding="utf-8")
    heads, columns = ["timestamp"], [arm.t_s + began_s]
    for name in ("shoulder", "elbow", "wrist"):
        heads += [f"{name}_right_{each}" for each in (*"xyz", "state")]
        columns += [arm.joint(name) * ([-1, 1, 1] if mirror else 1), arm.state[:, JOINTS.index(name)]]
    body = [line.replace("nan", "") for line in rows(*columns, form="{:.5f}")]
    kinect.write_text("\n".join([",".join(heads), *body]) + "\n", encoding="utf-8")
    return {"imu": sensor, "skeleton": kinect}


def own_table(path: Path, imu: Path) -> Path:
    """The same IMU in a laboratory's own layout."""
    lines = imu.read_text().splitlines()[3:]
    path.write_text("\n".join(["Zeit;F1;F2;F3;D1;D2;D3", *(line.replace(",", ";") for line in lines)]) + "\n")
    return path
