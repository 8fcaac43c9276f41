"""Videos, and models of a stand-in for MediaPipe that say who is in them; and what phones do to videos."""

from __future__ import annotations

import io
import struct
import sys
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from smoother.recording import JOINTS, JointState, Recording

STAND_IN = Path(__file__).parent / "stand_in"
WIDTH, HEIGHT, PIXELS_PER_M = 320, 240, 110.0
#: How red the quarters of each picture are, and with which landmark those of the left arm and hip begin.
QUARTERS = np.array([[240, 170], [90, 20]])
LEFT = {"shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23}


@contextmanager
def mediapipe_stand_in() -> Iterator[None]:
    """`import mediapipe` gives the stand-in."""
    mine = [name for name in sys.modules if name.split(".")[0] == "mediapipe"]
    kept = {name: sys.modules.pop(name) for name in mine}
    sys.path.insert(0, str(STAND_IN))
    try:
        yield
    finally:
        sys.path.remove(str(STAND_IN))
        for name in [name for name in sys.modules if name.split(".")[0] == "mediapipe"]:
            del sys.modules[name]
        sys.modules.update(kept)


@dataclass(frozen=True)
class Person:
    """Landmarks of a person in optical axes about the middle of the hips."""

    points: np.ndarray  # (F, 33, 3) m; nan where nobody is there
    visibility: np.ndarray  # (F, 33)
    middle: tuple[float, float] = (0.5, 0.62)  # Of the hips, as a part of the picture
    turn_deg: int = 0  # Clockwise, of the person in the picture

    def moved(self, x_m: float) -> Person:
        """The same elsewhere in the picture."""
        return replace(self, middle=(self.middle[0] + x_m * PIXELS_PER_M / WIDTH, self.middle[1]))

    @property
    def landmarks(self) -> np.ndarray:
        """As the stand-in gives them (F, 33, 6)."""
        turned = self.points @ Rotation.from_euler("z", self.turn_deg, degrees=True).as_matrix().T
        image = turned[..., :2] * PIXELS_PER_M / (WIDTH, HEIGHT) + self.middle
        return np.concatenate([self.points, self.visibility[..., None], image], axis=2)


def person_of(recording: Recording, t_s: np.ndarray) -> Person:
    """Whoever wears the right arm of a simulated recording (frame: x left, y up, z forward), at times."""
    arm, points = recording.arm, np.zeros((len(t_s), 33, 3))
    visibility = np.full((len(t_s), 33), 0.95)
    nearest = np.abs(t_s[:, None] - arm.t_s[None]).argmin(axis=1)
    for name in ("shoulder", "elbow", "wrist"):
        rows = arm.position[:, JOINTS.index(name)] * [-1, -1, 1]
        good = np.isfinite(rows).all(axis=1)
        for axis in range(3):
            points[:, LEFT[name] + 1, axis] = np.interp(t_s, arm.t_s[good], rows[good, axis])
        lost = arm.state[nearest, JOINTS.index(name)] == JointState.NOT_TRACKED
        visibility[lost, LEFT[name] + 1] = 0.95 if name == "shoulder" else 0.05
    # a right shoulder is on the picture's left
    points[:, 12:17:2] -= np.median(points[:, 12], axis=0) + np.array([0.18, 0.5, 0.0])
    points[:, 11:16:2] = [[0.18, -0.5, 0.0], [0.24, -0.22, 0.0], [0.26, 0.06, 0.0]]
    points[:, 23:25] = [[0.12, 0.0, 0.0], [-0.12, 0.0, 0.0]]
    return Person(points, visibility)


def write_video(path: Path, people: Sequence[Person], rate_hz: float, turn: int | None = None) -> Path:
    """As many pictures as people have places; `turn` as cv2.rotate has it, and mirrored with `turn` -1."""
    picture = np.full((HEIGHT, WIDTH, 3), 20, np.uint8)
    picture[..., 2] = np.kron(QUARTERS, np.ones((HEIGHT // 2, WIDTH // 2)))
    if turn is not None:
        picture = cv2.flip(picture, 1) if turn == -1 else cv2.rotate(picture, turn)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, picture.shape[1::-1])
    assert writer.isOpened()
    for _ in range(len(people[0].points) if people else 30):
        writer.write(picture)
    writer.release()
    return path


def write_model(path: Path, people: Sequence[Person], t_s: np.ndarray) -> Path:
    """A bundle for the stand-in, which gives people in another order from picture to picture."""
    each = np.array([person.landmarks for person in people]).reshape(-1, len(t_s), 33, 6)
    each[:, 1::2] = each[::-1, 1::2]
    numbers = io.BytesIO()
    np.savez(numbers, t_ms=1e3 * t_s, people=each)
    with zipfile.ZipFile(path, "w") as bundle:
        bundle.writestr("pose_detector.tflite", b"")
        bundle.writestr("pose_landmarks_detector.tflite", numbers.getvalue())
    return path


def _box(data: bytes, path: Sequence[bytes], start: int = 0) -> tuple[int, int]:
    """Where a box of an MP4 file begins and ends, by its boxes from the outermost in."""
    at, end = start, len(data)
    for name in path:
        while True:
            length, kind = struct.unpack(">I4s", data[at : at + 8])
            if kind == name:
                break
            at += length
            assert at < end, name
        end = at + length
        start, at = at, at + 8
    return start, end


def with_turn(path: Path, degrees: int) -> Path:
    """The same MP4 saying that its pictures are to be turned clockwise, as a phone held upright writes it."""
    data = bytearray(path.read_bytes())
    start, _ = _box(data, (b"moov", b"trak", b"tkhd"))
    matrix = start + 8 + 40  # behind version, times, track number, duration and layer (version 0)
    one, cos, sin = 0x10000, round(np.cos(np.radians(degrees))), round(np.sin(np.radians(degrees)))
    values = (cos * one, sin * one, 0, -sin * one, cos * one, 0, 0, 0, 0x40000000)
    data[matrix : matrix + 36] = struct.pack(">9i", *values)
    path.write_bytes(data)
    return path


def with_steps(path: Path, steps: Sequence[int]) -> Path:
    """The same MP4 with a step of its own behind each picture, in ticks of the track (variable rate)."""
    data = bytearray(path.read_bytes())
    edits, _ = _box(data, (b"moov", b"trak", b"edts"))  # would cut off what is longer than before
    data[edits + 4 : edits + 8] = b"free"
    outer = (b"moov", b"trak", b"mdia", b"minf", b"stbl")
    start, end = _box(data, (*outer, b"stts"))
    table = struct.pack(">II", 0, len(steps)) + b"".join(struct.pack(">II", 1, step) for step in steps)
    new = struct.pack(">I4s", 8 + len(table), b"stts") + table
    assert _box(data, (b"moov",))[0] > _box(data, (b"mdat",))[0]  # pictures before the tables stay in place
    grown = bytearray(data[:start] + new + data[end:])
    for depth in range(1, len(outer) + 1):
        at, _ = _box(data, outer[:depth])
        (length,) = struct.unpack(">I", data[at : at + 4])
        grown[at : at + 4] = struct.pack(">I", length + len(new) - (end - start))
    path.write_bytes(bytes(grown))
    return path
