"""The frames of all cameras as one stream, in the first camera's frame and on its clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import SolveError
from ..recording import FIRST_CAMERA, JOINTS, Camera, JointTracks, Recording
from ..runtime.store import Store, batches
from .clocks import candidate_offsets
from .faults import LEAST_S, fault_of, moved_from
from .overlap import Overlap
from .placing import Placement, place
from .rig import CameraRig, RelativeClock, RigCamera, first_camera, joint_centre

#: Where the joints are nearer than this, as a share of how far they move, no other clock is tried.
SURE_SHARE = 0.25


def join_cameras(recording: Recording, store: Store | None = None) -> tuple[Recording, CameraRig | None]:
    """A recording whose `arm` holds the frames of all cameras that agree.

    Constant errors of the joints differ between cameras; each camera's joints are moved to the mean of all.

    Parameters
    ----------
    recording : Recording
        With or without further cameras.
    store : Store, optional
        Where the joined frames are to lie; in memory where None.

    Returns
    -------
    recording : Recording
        Without further cameras; as it was where it has none.
    rig : CameraRig or None
        Where they stand and which were left out; None where there is one camera.
    """
    if any(arm.pixel_rad is not None for arm in (recording.arm, *(c.arm for c in recording.cameras))):
        raise SolveError(f"{recording.name}: keypoints of a camera without depth cannot be solved yet")
    if not recording.cameras:
        return recording, None
    placed = [placed_camera(camera, recording.arm) for camera in recording.cameras]
    rig = CameraRig((first_camera(FIRST_CAMERA), *placed))
    together = [
        (camera, row) for camera, row in zip(recording.cameras, placed, strict=True) if row.takes_part
    ]
    alone = replace(recording, cameras=())
    if not together:
        return alone, rig
    return replace(alone, arm=_joined(recording.arm, together, store or Store())), rig


def placed_camera(camera: Camera, first: JointTracks, name: str = FIRST_CAMERA) -> RigCamera:
    """A camera's row of the table, found from what it and the first one see together.

    Parameters
    ----------
    camera : Camera
    first : JointTracks
        The first camera's.
    name : str
        Of the first camera.

    Returns
    -------
    row : RigCamera
        With its pose as a prior where it was measured beforehand, unless the joints contradict that.
    """
    row = _placed(camera, first, name)
    if camera.pose is None:
        return row
    free = _placed(replace(camera, pose=None), first, name)
    if free.reason or free.pose is None:
        return row
    apart = moved_from(free.pose, camera.pose, np.asarray(first.position))
    return replace(free, note=apart) if apart else row


def _placed(camera: Camera, first: JointTracks, name: str) -> RigCamera:
    found: list[tuple[Placement, Overlap]] = []
    for offset_s in candidate_offsets(first, camera.arm):
        answer = place(first, camera.arm, RelativeClock(offset_s), camera.pose)
        if answer is None or answer[1].length_s < LEAST_S:
            continue
        found.append(answer)
        if answer[0].misfit_m < SURE_SHARE * answer[0].spread_m:
            break  # no other clock fits as well
    if not found:
        return RigCamera(
            camera.name,
            reason=f"it sees the forearm for less than {LEAST_S:g} s together with {name}, at no clock"
            " offset; put it where both see the arm, or let both see it for some seconds at the start",
        )
    best, together = min(found, key=lambda each: each[0].misfit_m)
    return RigCamera(
        camera.name,
        best.pose,
        best.clock,
        best.offset_m,
        best.misfit_m,
        together.length_s,
        fault_of(found, best, name),
    )


def _joined(first: JointTracks, further: list[tuple[Camera, RigCamera]], store: Store) -> JointTracks:
    """All frames in the order of time."""
    times = [np.asarray(first.t_s), *(row.clock.to_first(np.asarray(c.arm.t_s)) for c, row in further)]
    t = np.concatenate(times)
    order = np.argsort(t, kind="stable")
    place_of = np.empty(len(order), np.int64)
    place_of[order] = np.arange(len(order))
    position = store.array((len(t), len(JOINTS), 3))
    state = np.zeros((len(t), len(JOINTS)), np.int8)
    camera = np.zeros(len(t), np.int8)
    mean_m = joint_centre([row.joint_offset_m for _, row in further])
    begin = 0
    for number, (arm, row) in enumerate([(first, None), *((c.arm, row) for c, row in further)]):
        for part in batches(len(arm)):
            rows = place_of[begin + part.start : begin + part.stop]
            points = np.asarray(arm.position[part])
            if row is None:
                position[rows] = points - mean_m
            else:
                assert row.pose is not None
                position[rows] = row.pose.to_first(points) + row.joint_offset_m - mean_m
            state[rows] = arm.state[part]
            camera[rows] = number
        begin += len(arm)
    return JointTracks(first.name, t[order], position, state, camera)
