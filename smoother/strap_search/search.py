"""The strap found in a recording's images, written into the recording as the joint `strap`."""

from __future__ import annotations

import os
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.strap import Depth, Mounted, Sighting, find_strap

from ..array_types import FloatArray, IntArray
from ..errors import RecordingError
from ..io.mcap.container import Container
from ..io.mcap.merge import Output
from ..io.mcap.messages import Topic
from ..io.recording.read import METADATA, is_motion, open_recording
from ..io.recording.streams import ArmFrames
from ..io.recording.write import arm_messages
from ..io.rig.images import ImageMessage
from ..io.rig.strap import Cameras, StrapFound
from ..linalg import robust_sigma
from ..recording import JOINTS, CameraFrame, JointState
from ..runtime.outputs import writing

#: A colour image, a depth image and a skeleton frame belong together within this, s.
TOGETHER_S = 0.02
#: The camera's forearm may be this far from the inertial one (Jatesiktat & Ang, II-J.1), rad.
DIRECTION_RAD = np.radians(30.0)
#: Images of one kind are kept packed until their partners came, at most this many.
AHEAD = 64
#: A level optical camera's axes from {K} by the convention of {K}.
_OPTICAL = {CameraFrame.OPTICAL: np.eye(3), CameraFrame.KINECT: np.diag([-1.0, -1.0, 1.0])}
_STRAP, _ELBOW, _WRIST = (JOINTS.index(joint) for joint in ("strap", "elbow", "wrist"))


def import_strap(
    source: str | os.PathLike[str],
    path: str | os.PathLike[str],
    mounted: Mounted,
    *,
    skeleton: str,
    side: str,
    joint_sigma_m: float = 0.008,
    colour_topic: str | None = None,
    depth_topic: str | None = None,
    force: bool = False,
) -> StrapFound:
    """Look for the strap in every colour image and write the recording with the joint `strap`."""
    file = open_recording(source)
    arms = [arm for arm in file.arms if arm.topic == skeleton]
    fitting = [arm for arm in arms if arm.side in (side, "")]
    if not fitting:
        raise RecordingError(f"{source}: {skeleton} has no {side} arm.")
    arm = max(fitting, key=lambda each: each.tracked)
    convention = file.camera_frame or arm.camera_frame
    if convention not in _OPTICAL:
        raise RecordingError(
            f"{source}: the skeleton's axes in the camera are unknown (kinect or optical); state camera_frame"
            " in the recording."
        )
    cameras = Cameras(source, colour_topic, depth_topic, _OPTICAL[convention])
    estimates = _locate_all(cameras, arm, mounted, joint_sigma_m)
    position, state = arm.position.copy(), arm.state.copy()
    covariances = np.zeros((len(position), 9))
    position[:, _STRAP], state[:, _STRAP] = np.nan, JointState.NOT_TRACKED
    for row, (at, covariance) in estimates.items():
        position[row, _STRAP], state[row, _STRAP] = at, JointState.TRACKED
        covariances[row] = covariance.ravel()
    with_strap = replace(arm, position=position, state=state)

    def wanted(topic: Topic) -> bool:
        return topic.name != skeleton and is_motion(topic)

    with writing(path, force) as temporary, Output(temporary) as output:
        metadata = {**file.metadata.get(METADATA, {}), "camera_frame": str(convention)}
        output.metadata(METADATA, metadata)
        outgoing = [
            arm_messages(output, with_strap, strap_covariance=covariances)
            if each is arm
            else arm_messages(output, each)
            for each in arms
        ]
        container = Container(source)
        for chunk in container.chunks():
            mine = [number for number, topic in enumerate(container.topics) if wanted(topic)]
            output.copy(container.topics, chunk.select(np.flatnonzero(np.isin(chunk.topic, mine))))
        output.write(outgoing)
    cameras.found.notes.append("Images and other topics without motion were left out.")
    return cameras.found


def _locate_all(
    cameras: Cameras, arm: ArmFrames, mounted: Mounted, joint_sigma_m: float
) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Position and covariance of the sensor by frame of the arm; figures go to `cameras.found`."""
    depths: deque[ImageMessage] = deque(maxlen=AHEAD)
    waiting: deque[ImageMessage] = deque(maxlen=AHEAD)
    estimates: dict[int, tuple[FloatArray, FloatArray]] = {}
    rows: list[tuple[float, FloatArray, FloatArray, float, str]] = []
    first: int | None = None

    def add_image(colour: ImageMessage) -> None:
        nonlocal first
        first = colour.stamp_ns if first is None else first
        t = (colour.stamp_ns - first) / 1e9
        place, covariance, sighting = np.full(3, np.nan), np.full((3, 3), np.nan), Sighting("no depth image")
        depth = min(depths, key=lambda each: abs(each.stamp_ns - colour.stamp_ns), default=None)
        row = _nearest(arm.stamp_ns, colour.stamp_ns)
        if depth is not None and abs(depth.stamp_ns - colour.stamp_ns) < TOGETHER_S * 1e9:
            place, covariance, sighting = _locate(cameras, arm, mounted, joint_sigma_m, colour, depth, row)
        if not sighting.reason and row is not None:
            estimates[row] = place, covariance
        sigma = np.sqrt(np.diag(covariance))
        rows.append((t, place, sigma, sighting.along, sighting.reason))

    for role, image in cameras.images():
        if role == "depth":
            depths.append(image)
        else:
            waiting.append(image)
        while waiting and (
            len(waiting) == AHEAD or (depths and depths[-1].stamp_ns > waiting[0].stamp_ns + TOGETHER_S * 1e9)
        ):
            add_image(waiting.popleft())
    while waiting:
        add_image(waiting.popleft())
    results = cameras.found
    if rows:
        t_s, place, sigma, along, reasons = zip(*rows, strict=True)
        results.t_s, results.position, results.sigma_m = np.array(t_s), np.array(place), np.array(sigma)
        results.along, results.reasons = np.array(along), list(reasons)
    return estimates


def _nearest(stamps: IntArray, stamp_ns: int) -> int | None:
    k = int(np.clip(np.searchsorted(stamps, stamp_ns), 1, max(len(stamps) - 1, 1)))
    best = min((k - 1, min(k, len(stamps) - 1)), key=lambda i: abs(int(stamps[i]) - stamp_ns))
    return best if abs(int(stamps[best]) - stamp_ns) < TOGETHER_S * 1e9 else None


def _locate(
    cameras: Cameras,
    arm: ArmFrames,
    mounted: Mounted,
    joint_sigma_m: float,
    colour: ImageMessage,
    depth: ImageMessage,
    row: int | None,
) -> tuple[FloatArray, FloatArray, Sighting]:
    """The sensor's position in one image with its covariance, and the sighting."""
    nothing = np.full(3, np.nan), np.full((3, 3), np.nan)
    if row is None or not (arm.state[row, [_ELBOW, _WRIST]] == JointState.TRACKED).all():
        return *nothing, Sighting("elbow or wrist is not tracked")
    elbow, wrist = arm.position[row, _ELBOW], arm.position[row, _WRIST]
    t = (int(arm.stamp_ns[row]) - mounted.origin_ns) / 1e9
    k = int(np.argmin(np.abs(mounted.t_s - t))) if len(mounted.t_s) else 0
    if not len(mounted.t_s) or abs(mounted.t_s[k] - t) > 0.05 or not np.isfinite(mounted.R_K_A[k]).all():
        return *nothing, Sighting("the sensor's orientation is not known")
    R_K_A = mounted.R_K_A[k]
    if mounted.along is not None:
        y = (wrist - elbow) / max(float(np.linalg.norm(wrist - elbow)), 1e-6)
        if y @ (R_K_A @ mounted.along) < np.cos(DIRECTION_RAD):
            return *nothing, Sighting("the camera's forearm does not point where the inertial one does")
    grey, z = grey_of(colour), metres_of(depth)
    sighting = find_strap(
        grey,
        cameras.camera("colour", grey.shape, colour, depth),
        Depth(z, cameras.camera("depth", z.shape, depth, depth)),
        elbow,
        wrist,
        radius_m=mounted.radius_m,
        joint_sigma_m=joint_sigma_m,
    )
    place = sighting.core + R_K_A @ mounted.from_core
    return place, sighting.covariance + mounted.sigma_m**2 * np.eye(3), sighting


def grey_of(image: ImageMessage) -> NDArray[np.uint8]:
    """Brightness (height, width) of a colour image."""
    import cv2

    pixels = image.pixels()
    if pixels.ndim == 2:
        return np.asarray(pixels, np.uint8)
    code = cv2.COLOR_RGB2GRAY if image.encoding.startswith("rgb") else cv2.COLOR_BGR2GRAY
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., :3]), code), np.uint8)


def metres_of(image: ImageMessage) -> FloatArray:
    """Depth (height, width), m; nan where there is none. 16 bit counts millimetres, floats metres."""
    pixels = image.pixels()
    z = pixels * (1e-3 if pixels.dtype == np.uint16 else 1.0)
    return np.where(z > 0, z, np.nan).astype(np.float64)


#: A strap that wanders along the forearm by more than this part of it was at times something else.
WANDER = 0.06


def strap_verdict(search: StrapFound) -> list[str]:
    """How often and how well the strap was seen."""
    total = len(search.reasons)
    good = np.array([not reason for reason in search.reasons], dtype=bool)
    if not good.any():
        worst = max(search.counts, key=lambda name: search.counts[name]) if total else "there are no images"
        return [f"the strap was found in none of {total} images: {worst}"]
    sigma = 1e3 * float(np.sqrt(np.mean(np.median(search.sigma_m[good], axis=0) ** 2)))
    middle = float(np.median(search.along[good]))
    wander = float(robust_sigma(search.along[good] - middle))
    sentences = [
        f"the strap was found in {int(good.sum())} of {total} images ({100 * good.mean():.0f} %), the"
        f" sensor's place to {sigma:.0f} mm per axis",
        f"it sits at {100 * middle:.0f} % of the way from elbow to wrist, +- {100 * wander:.1f} % from"
        " image to image",
    ]
    if wander > WANDER:
        sentences.append("that is too much for a tight strap: something else was sometimes detected instead")
    return sentences
