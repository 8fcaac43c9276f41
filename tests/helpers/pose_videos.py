"""Videos of people drawn as discs, which the stand-in for MediaPipe finds; and what phones do to videos."""

from __future__ import annotations

import io
import struct
import sys
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from smoother.recording import JOINTS, JointState, Recording

STAND_IN = Path(__file__).parent / "stand_in"
WIDTH, HEIGHT, PIXELS_PER_M, RADIUS = 320, 240, 110.0, 6
#: Hips below the shoulder's height and beside the worn arm's shoulder, and half the shoulders' width, m.
TRUNK_M, HALF_M = 0.5, 0.18
DISC_PIXELS = float(np.count_nonzero(cv2.circle(np.zeros((40, 40), np.uint8), (20, 20), RADIUS, 1, -1)))


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


@dataclass
class Person:
    """Discs of a person: (F, 8, 3) m in optical axes about the middle of the hips, and which are seen."""

    points: np.ndarray
    seen: np.ndarray

    def moved(self, x_m: float) -> Person:
        """The same elsewhere in the picture."""
        return Person(self.points + np.array([x_m, 0.0, 0.0]), self.seen.copy())


def person_of(recording: Recording, t_s: np.ndarray) -> Person:
    """Whoever wears the right arm of a simulated recording (frame: x left, y up, z forward), at times."""
    arm = recording.arm
    turned = arm.position * [-1, -1, 1]
    names = ("shoulder", "elbow", "wrist")
    columns = {}
    for name in names:
        rows = turned[:, JOINTS.index(name)]
        good = np.isfinite(rows).all(axis=1)
        columns[name] = np.stack(
            [np.interp(t_s, arm.t_s[good], rows[good, axis]) for axis in range(3)], axis=1
        )
    nearest = np.abs(t_s[:, None] - arm.t_s[None]).argmin(axis=1)
    shoulder = np.median(columns["shoulder"], axis=0)
    hips = shoulder + np.array([HALF_M, TRUNK_M, 0.0])  # a right shoulder is on the picture's left
    still = np.zeros((len(t_s), 3))
    left = {
        "shoulder": [HALF_M, -TRUNK_M, 0.0],
        "elbow": [HALF_M + 0.06, -0.22, 0.0],
        "wrist": [HALF_M + 0.08, 0.06, 0.0],
    }
    points, seen = [], []
    for name in names:
        points += [still + left[name], columns[name] - hips]
        seen += [np.ones(len(t_s), bool), arm.state[nearest, JOINTS.index(name)] != JointState.NOT_TRACKED]
    points += [still + np.array([0.12, 0.0, 0.0]), still - np.array([0.12, 0.0, 0.0])]
    seen += [np.ones(len(t_s), bool)] * 2
    seen[1] = np.ones(len(t_s), bool)
    return Person(np.stack(points, axis=1), np.stack(seen, axis=1))


def draw(person: Sequence[Person], row: int) -> np.ndarray:
    """A picture (240, 320, 3), blue first."""
    from mediapipe.tasks.python.vision import PARTS, colour

    picture = np.full((HEIGHT, WIDTH, 3), 20, np.uint8)
    for who, each in enumerate(person):
        for k in range(2 * len(PARTS)):
            if each.seen[row, k]:
                u, v = each.points[row, k, :2] * PIXELS_PER_M + (WIDTH / 2, 0.62 * HEIGHT)
                at = (round(16 * u), round(16 * v))
                rgb = colour(who, k // 2, k % 2)
                cv2.circle(picture, at, 16 * RADIUS, [int(c) for c in rgb[::-1]], -1, cv2.LINE_AA, 4)
    return picture


def write_video(path: Path, people: Sequence[Person], rate_hz: float, turn: int | None = None) -> Path:
    """Pictures of people as a video; `turn` as cv2.rotate has it, and mirrored with `turn` -1."""
    size = (
        (HEIGHT, WIDTH)
        if turn in (cv2.ROTATE_90_CLOCKWISE, cv2.ROTATE_90_COUNTERCLOCKWISE)
        else (WIDTH, HEIGHT)
    )
    kind = "mp4v" if path.suffix == ".mp4" else "MJPG"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*kind), rate_hz, size)
    assert writer.isOpened()
    frames = len(people[0].points) if people else 30
    with mediapipe_stand_in():
        for row in range(frames):
            picture = draw(people, row)
            if turn is not None:
                picture = cv2.flip(picture, 1) if turn == -1 else cv2.rotate(picture, turn)
            writer.write(picture)
    writer.release()
    return path


def write_model(path: Path, people: Sequence[Person], t_s: np.ndarray) -> Path:
    """A bundle for the stand-in, which knows the depths by time."""
    depth = np.zeros((2, len(t_s), 8))
    for who, each in enumerate(people):
        depth[who] = each.points[..., 2]
    numbers = io.BytesIO()
    np.savez(numbers, t_ms=1e3 * t_s, depth_m=depth, pixels_per_m=PIXELS_PER_M, disc_pixels=DISC_PIXELS)
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
