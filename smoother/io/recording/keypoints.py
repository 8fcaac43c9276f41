"""Cameras of a file: keypoints of one without depth, lenses that make rays of them, further cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.intrinsics import LARGEST_SHARE, SHARE_RANGE, Intrinsics

from ...array_types import FloatArray
from ...errors import RecordingError
from ...linalg import unit
from ...recording import JOINTS, Camera, CameraFrame, CameraPose, JointState, JointTracks
from ...runtime.store import by_rows
from ..mcap.messages import seconds
from .clean import clean_arm
from .decode import INFERRED_SCORE, TRACKED_SCORE
from .decode import states_of_scores as states_of_scores
from .streams import ArmFrames, CameraStream, KnownLens, RecordingFile

#: Where the messages of the first camera are written to, and of one with a name.
TOPIC, NAMED_TOPIC = "/camera/keypoints_2d", "/camera/{}/keypoints_2d"
#: Where the skeletons of further cameras are written to, each under its name.
CAMERA_TOPIC = "/skeleton/"
#: Networks place joints beyond the image's edge by this part of it, and hardly more than this share beyond.
BEYOND, OUTSIDE_SHARE = 0.05, 0.01


def with_lenses(file: RecordingFile, topics: set[str]) -> None:
    """Give keypoints their lenses; those of a camera with an unknown lens are left out, with a note."""
    file.arms = [arm for arm in file.arms if arm.topic not in topics or arm.topic in file.lenses]
    for arm in file.arms:
        if arm.topic in topics:
            arm.lens, arm.camera_frame = file.lenses[arm.topic].lens, CameraFrame.OPTICAL
    for topic in sorted(topics - file.lenses.keys()):
        file.notes.append(
            f"{topic}: the camera's lens is not known, so its keypoints were left out; import them again with"
            " --intrinsics."
        )


def tracks_of(arm: ArmFrames, origin_ns: int) -> JointTracks:
    """Cleaned frames as a recording has them: of a camera without depth the points become rays."""
    t_s = seconds(arm.stamp_ns, origin_ns)
    if arm.lens is None:
        return JointTracks(arm.topic, t_s, arm.position, arm.state)
    lens = arm.lens
    check_mode(arm, lens)

    def rays(position: FloatArray) -> FloatArray:
        across = lens.rays(position[..., :2].reshape(-1, 2)).reshape(*position.shape[:2], 2)
        forwards = np.where(np.isfinite(across).all(axis=2), 1.0, np.nan)
        return np.concatenate([across, forwards[..., None]], axis=2)

    points, pixel_rad = by_rows(rays, arm.position), 1.0 / lens.focal_px
    return JointTracks(arm.topic, t_s, points, arm.state, pixel_rad=pixel_rad, focal_share=lens.focal_share)


def check_mode(arm: ArmFrames, lens: Intrinsics) -> None:
    """Refuse keypoints of larger images than the lens is stated for."""
    pixels = np.asarray(arm.position)[np.asarray(arm.state) == JointState.TRACKED][:, :2]
    size = np.array([lens.width, lens.height])
    outside = ((pixels < -BEYOND * size) | (pixels > (1.0 + BEYOND) * size)).any(axis=1)
    if not len(pixels) or outside.mean() <= OUTSIDE_SHARE:
        return
    least, most = np.nanpercentile(pixels, [0.5, 99.5], axis=0)
    raise RecordingError(
        f"{arm.topic}: the lens is stated for images of {lens.width} x {lens.height} pixels; keypoints are"
        f" at {least[0]:.0f} to {most[0]:.0f} across and {least[1]:.0f} to {most[1]:.0f} down: they are of"
        " another mode of the camera. Import them again with --intrinsics of the mode that was recorded."
    )


def pixels_of(tracks: JointTracks, lens: Intrinsics) -> FloatArray:
    """Rays (F, 5, 3) as u, v and score; the score of a state is in the middle of its range."""
    position = np.full(tracks.position.shape, np.nan)
    position[..., :2] = lens.pixels(np.asarray(tracks.position).reshape(-1, 3)).reshape(-1, len(JOINTS), 2)
    position[..., 2] = np.choose(
        np.asarray(tracks.state), [0.0, 0.5 * (INFERRED_SCORE + TRACKED_SCORE), 0.5 * (TRACKED_SCORE + 1.0)]
    )
    return position


#: Keys of a lens as metadata and recording.toml hold it.
_SIZE, _NUMBERS, _TERMS = ("width", "height"), ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2", "k3")


def lens_plain(lens: Intrinsics) -> dict[str, Any]:
    """A lens as metadata and recording.toml hold it."""
    terms = {name: float(value) for name, value in zip(_TERMS, lens.distortion, strict=False) if value}
    numbers = {name: float(getattr(lens, name)) for name in _NUMBERS}
    size = {name: getattr(lens, name) for name in _SIZE}
    return {**size, **numbers, **terms, "focal_share": lens.focal_share}


def lens_from_plain(values: Mapping[str, Any]) -> Intrinsics:
    """From plain values; raises `ValueError`, `TypeError` or `KeyError` where they are none."""
    if unknown := set(values) - {*_SIZE, *_NUMBERS, *_TERMS, "focal_share"}:
        raise ValueError(f"{sorted(unknown)[0]} is not a key of a lens")
    width, height = (int(values[name]) for name in _SIZE)
    fx, fy, cx, cy = (float(values[name]) for name in _NUMBERS)
    terms = tuple(float(values.get(name, 0.0)) for name in _TERMS)
    if not (np.isfinite([fx, fy, cx, cy, *terms]).all() and min(fx, fy, width, height) > 0):
        raise ValueError("focal lengths and sizes are above zero")
    share = float(values.get("focal_share", 0.0))
    if not 0.0 <= share <= LARGEST_SHARE:
        raise ValueError(SHARE_RANGE)
    return Intrinsics(width, height, fx, fy, cx, cy, terms if any(terms) else (), share)


def lenses_plain(lenses: Mapping[str, KnownLens]) -> dict[str, dict[str, Any]]:
    """As a file's metadata holds them, by topic."""
    plain: dict[str, dict[str, Any]] = {}
    for topic, known in lenses.items():
        plain[topic] = {"intrinsics": lens_plain(known.lens)}
        if known.pose is not None:
            plain[topic]["pose"] = {
                "R_K_C": known.pose.R_K_C.tolist(),
                "p_K_C_m": known.pose.p_K_C_m.tolist(),
                "sigma_deg": float(np.degrees(known.pose.sigma_rad)),
                "sigma_m": known.pose.sigma_m,
            }
    return plain


def lenses_from_plain(values: Mapping[str, Mapping[str, Any]]) -> dict[str, KnownLens]:
    """From metadata; raises `ValueError`, `TypeError` or `KeyError` where it is none."""
    lenses = {}
    for topic, each in dict(values).items():
        pose = None
        if each.get("pose") is not None:
            R = np.array(each["pose"]["R_K_C"], float).reshape(3, 3)
            p = np.array(each["pose"]["p_K_C_m"], float).reshape(3)
            if not (np.isfinite(p).all() and np.allclose(R @ R.T, np.eye(3), atol=1e-4)):
                raise ValueError("R_K_C is not a rotation")
            sigma_rad = float(np.radians(float(each["pose"]["sigma_deg"])))
            pose = CameraPose(R, p, sigma_rad, float(each["pose"]["sigma_m"]))
        lenses[str(topic)] = KnownLens(lens_from_plain(each["intrinsics"]), pose)
    return lenses


def camera_of(
    stream: CameraStream,
    arm: ArmFrames,
    source: str,
    origin_ns: int,
    lenses: Mapping[str, KnownLens],
) -> tuple[Camera | None, list[str]]:
    """A further camera with cleaned frames; None and a sentence where they cannot be used."""
    try:
        clean, notes = clean_arm(arm, source)
    except RecordingError as error:
        return None, [f"{stream.name} was left out: {error}"]
    tracks = tracks_of(clean, origin_ns)
    frame = stream.camera_frame or clean.camera_frame
    known = lenses.get(arm.topic)
    pose = None if known is None else known.pose
    return Camera(stream.name, tracks, frame, stream.gravity_hint, pose), notes


def cameras_plain(cameras: dict[str, CameraStream]) -> dict[str, dict[str, object]]:
    """As a file's metadata holds them."""
    return {
        topic: {
            "name": camera.name,
            "camera_frame": None if camera.camera_frame is None else str(camera.camera_frame),
            "gravity": None if camera.gravity_hint is None else [float(x) for x in camera.gravity_hint],
        }
        for topic, camera in cameras.items()
    }


def cameras_from_plain(values: dict[str, dict[str, object]]) -> dict[str, CameraStream]:
    """From metadata; raises `ValueError`, `TypeError` or `KeyError` where it is none."""
    return {
        str(topic): CameraStream(
            str(each["name"]),
            CameraFrame(str(each["camera_frame"])) if each.get("camera_frame") else None,
            direction_of(each["gravity"]) if each.get("gravity") is not None else None,
        )
        for topic, each in dict(values).items()
    }


def direction_of(value: object) -> FloatArray:
    """Down as plain values state it; raises `ValueError` or `TypeError` where they do not."""
    gravity = np.array(value, float).reshape(3)
    direction = np.asarray(unit(gravity))
    if not (np.isfinite(gravity).all() and abs(float(np.linalg.norm(direction)) - 1) < 1e-6):
        raise ValueError("gravity is not a direction")
    return direction
