"""Skeleton files of the layouts that camera programs write, made of a body that moves its arms."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smoother.io.tables.joints import AZURE, BLAZEPOSE, BODY_25, KINECT_V2

#: Parts of a standing body, m: x to its left, y up, z to its back; the origin under it.
_PARTS = {
    "pelvis": (0.0, 0.95, 0.0), "navel": (0.0, 1.1, 0.0), "chest": (0.0, 1.25, 0.0), "neck": (0.0, 1.45, 0.0),
    "head": (0.0, 1.6, 0.0), "nose": (0.0, 1.6, -0.1),
    "clavicle": (0.08, 1.42, 0.0), "shoulder": (0.18, 1.4, 0.0), "elbow": (0.22, 1.12, 0.0),
    "wrist": (0.24, 0.9, -0.08),
    "hand": (0.25, 0.84, -0.1), "handtip": (0.25, 0.78, -0.1), "thumb": (0.22, 0.82, -0.12),
    "hip": (0.1, 0.92, 0.0), "knee": (0.1, 0.5, 0.0), "ankle": (0.1, 0.08, 0.0), "foot": (0.1, 0.02, -0.15),
    "eye": (0.03, 1.63, -0.09), "ear": (0.07, 1.6, 0.0), "mouth": (0.02, 1.55, -0.09),
    "heel": (0.1, 0.03, 0.05),
    "pinky": (0.27, 0.8, -0.1), "index": (0.24, 0.79, -0.11),
}  # fmt: skip
_ALIAS = {
    "navalspine": "navel", "chestspine": "chest",
    "spine_naval": "navel", "spinenavel": "navel", "spinechest": "chest", "spinebase": "pelvis",
    "spinemid": "navel", "spineshoulder": "neck", "midhip": "pelvis", "bigtoe": "foot", "smalltoe": "foot",
    "footindex": "foot", "eyeinner": "eye", "eyeouter": "eye",
}  # fmt: skip


def part(name: str, frames: int) -> np.ndarray:
    """Positions (frames, 3) of a joint by any of its names: y up, m, to the micrometre."""
    flat = "".join(c for c in name.lower() if c.isalnum())
    side = 0.0
    for word, value in (("left", 1.0), ("right", -1.0)):
        if word in flat:
            flat, side = flat.replace(word, ""), value
    if side == 0.0 and name[:1] in "LR" and name[1:2].isupper():
        flat, side = flat[1:], 1.0 if name[0] == "L" else -1.0
    x, y, z = _PARTS[_ALIAS.get(flat, flat)]
    t = np.arange(frames) / 30.0
    position = np.tile([side * x, y, z], (frames, 1))
    if flat in ("wrist", "hand", "elbow", "pinky", "index", "thumb", "handtip"):
        reach = {"elbow": 0.05}.get(flat, 0.15)
        position += reach * np.stack([np.sin(2 * t + side), np.cos(1.7 * t), np.sin(3 * t)], axis=1)
    return np.round(position, 6)


def parts(names: Sequence[str], frames: int) -> np.ndarray:
    """Positions (frames, n, 3) of several joints."""
    return np.stack([part(name, frames) for name in names], axis=1)


def optical(position: np.ndarray) -> np.ndarray:
    """From the body's axes to those of a camera 2.5 m in front: x right, y down, z forward."""
    return np.round(position * [1.0, -1.0, -1.0] * [1, 1, -1] + [0.0, 1.0, 2.5], 6)


def azure_csv(path: Path, frames: int = 40, confidence: int = 2, body: Sequence[int] = (1,)) -> None:
    """As the mkv extractor: `;`, times in us, mm, confidences; the hand's are 0."""
    header = ["timestamp", "body_idx"] + [f"{name} ({axis})" for name in AZURE for axis in "cxyz"]
    lines = [";".join(header)]
    for at in range(frames):
        for number in body:
            cells = [str(200_219 + 33_333 * at), str(number)]
            for name in AZURE:
                xyz = 1000 * optical(part(name, frames))[at] + [100.0 * number, 0, 0]
                is_hand = name.startswith(("HAND", "THUMB"))
                cells += [str(0 if is_hand else confidence)] + [f"{value:.6f}" for value in xyz]
            lines.append(";".join(cells))
    path.write_text("\n".join(lines) + "\n")


def expected(joint: str, frames: int, axes: str = "up") -> np.ndarray:
    """Where a joint (`wrist_right`) is, m."""
    name, _, side = joint.partition("_")
    position = part(f"{side}_{name}", frames)
    return optical(position) if axes == "optical" else position


def trc(path: Path, names: dict[str, np.ndarray], unit: str = "m", rate: float = 30.0) -> None:
    """A TRC file of these markers, in the unit."""
    count = len(next(iter(names.values())))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{count}\t{len(names)}\t{unit}\t{rate}\t1\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(len(names)) for axis in "XYZ"),
        "",
    ]
    for at in range(count):
        cells = [f"{value:.6f}" for rows in names.values() for value in rows[at]]
        lines.append("\t".join([str(at + 1), f"{at / rate:.9f}", *cells]))
    path.write_text("\n".join(lines) + "\n")


def c3d(
    path: Path,
    position: np.ndarray,
    *,
    unit: str = "mm",
    rate: float = 100.0,
    labels: Sequence[str] = (),
    segments: dict[str, np.ndarray] | None = None,
) -> Path:
    """Points (frames, points, 3) in the file's unit; origins (frames, 3) of segments beside them."""
    import ezc3d

    file, count = ezc3d.c3d(), position.shape[1]
    parameters = file["parameters"]["POINT"]
    parameters["RATE"]["value"], parameters["UNITS"]["value"] = [rate], [unit]
    parameters["LABELS"]["value"] = list(labels) or [f"M{k}" for k in range(count)]
    points = np.ones((4, count, len(position)))
    points[:3] = np.moveaxis(position, (0, 1, 2), (2, 1, 0))
    file["data"]["points"] = points
    if segments:
        poses = np.tile(np.eye(4)[:, :, None, None], (1, 1, len(segments), len(position)))
        poses[:3, 3] = np.moveaxis(np.stack(list(segments.values())), 2, 0)
        stated = {"USED": [len(segments)], "RATE": [rate], "RATIO": [1], "LABELS": list(segments)}
        for name, value in stated.items():
            file.add_parameter("ROTATION", name, value)
        file["data"]["rotations"] = poses
    file.write(str(path))
    return path


def landmarks(frames: int) -> np.ndarray:
    """World landmarks (frames, 33, 3): about the hips, x right, y down, z forward, m."""
    return np.round((parts(BLAZEPOSE, frames) - [0.0, 0.92, 0.0]) * [1.0, -1.0, 1.0], 6)


def kinect_v2(frames: int) -> np.ndarray:
    """Joints (frames, 25, 3) in the Kinect v2's order and axes, m."""
    return np.asarray(parts(KINECT_V2, frames) + np.array([0.0, -1.0, 2.5]))


def body_25(frames: int) -> np.ndarray:
    """OpenPose's 25 points in space (frames, 25, 3), y up, m."""
    return parts(BODY_25, frames)


def xdf(path: Path, streams: Sequence[dict[str, object]]) -> None:
    """An XDF file of streams: `name`, `type`, `rate`, `channels`, `t_s`, `values`, `offset`."""
    out = bytearray(b"XDF:")

    def chunk(tag: int, content: bytes) -> None:
        body = struct.pack("<H", tag) + content
        out.extend(b"\x04" + struct.pack("<I", len(body)) + body)

    chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")
    for number, stream in enumerate(streams, 1):
        values = np.asarray(stream["values"], dtype="<f8")
        channels = "".join(
            f"<channel><label>{label}</label><unit>{unit}</unit></channel>"
            for label, unit in stream["channels"]  # type: ignore[attr-defined]
        )
        info = (
            f"<?xml version='1.0'?><info><name>{stream['name']}</name><type>{stream['type']}</type>"
            f"<channel_count>{values.shape[1]}</channel_count><nominal_srate>{stream['rate']}</nominal_srate>"
            f"<channel_format>double64</channel_format><desc><channels>{channels}</channels></desc></info>"
        )
        chunk(2, struct.pack("<I", number) + info.encode())
        offset = stream.get("offset")
        t_s = np.asarray(stream["t_s"], dtype=float)
        if offset is not None:
            for when in (t_s[0], t_s[-1]):
                chunk(4, struct.pack("<Idd", number, when, offset))
        samples = bytearray(struct.pack("<I", number) + b"\x04" + struct.pack("<I", len(values)))
        for t, row in zip(t_s, values, strict=True):
            samples += b"\x08" + struct.pack("<d", t) + row.tobytes()
        chunk(3, bytes(samples))
        footer = f"<?xml version='1.0'?><info><sample_count>{len(values)}</sample_count></info>"
        chunk(6, struct.pack("<I", number) + footer.encode())
    path.write_bytes(bytes(out))
