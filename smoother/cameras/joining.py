"""The frames of all cameras as one stream, in the first camera's frame and on its clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..errors import SolveError
from ..recording import FIRST_CAMERA, JOINTS, Camera, CameraPose, JointTracks, Recording
from ..runtime.store import batches, large_array
from .alone import lift_alone
from .faults import LEAST_S, fault_of, moved_from, never_together
from .keypoint_places import clock_of_known_place, placed_keypoints
from .placing import Placement, place
from .rig import (
    CameraRig,
    Overlap,
    RelativeClock,
    RigCamera,
    candidate_offsets,
    depth_by_points,
    depth_by_rays,
    first_camera,
    joint_centre,
    lifted,
    overlap,
)

#: Where the joints are nearer than this, as a share of how far they move, no other clock is tried.
SURE_SHARE = 0.25
#: Rays of cameras whose places are known pass each other by no more than this, m (root mean square), if both
#: see one arm: those of seven that did by 11 to 19 mm, of nine wrong cameras by 48 to 183.
RAYS_M = 0.04
#: An adult's forearm, m.
FOREARM_M = 0.25


def join_cameras(recording: Recording, forearm_m: float = FOREARM_M) -> tuple[Recording, CameraRig | None]:
    """A recording whose `arm` contains the frames of all cameras that agree."""
    if recording.arm.pixel_rad is not None and not recording.cameras:
        return lift_alone(recording, forearm_m), None
    if recording.arm.pixel_rad is not None:
        return _of_pixels(recording)
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
    return replace(alone, arm=_joined(recording.arm, together)), rig


def placed_camera(camera: Camera, first: JointTracks, name: str = FIRST_CAMERA) -> RigCamera:
    """A camera's row of the table, found from what it and the first one see together."""
    if camera.arm.pixel_rad is not None:
        return placed_keypoints(camera, first, name)
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
        return RigCamera(camera.name, reason=never_together(name))
    best, together = min(found, key=lambda each: each[0].misfit_m)
    reason, moved_s = fault_of(found, best, name)
    found_so = best.pose, best.clock, best.offset_m, best.misfit_m, together.length_s
    return RigCamera(camera.name, *found_so, reason, moved_s=moved_s)


def _joined(first: JointTracks, further: list[tuple[Camera, RigCamera]]) -> JointTracks:
    """All frames in the order of time."""
    times = [np.asarray(first.t_s), *(row.clock.to_first(np.asarray(c.arm.t_s)) for c, row in further)]
    t = np.concatenate(times)
    order = np.argsort(t, kind="stable")
    place_of = np.empty(len(order), np.int64)
    place_of[order] = np.arange(len(order))
    position = large_array((len(t), len(JOINTS), 3))
    state = np.zeros((len(t), len(JOINTS)), np.int8)
    camera = np.zeros(len(t), np.int8)
    # of what joints of cameras with depth are off by
    mean_m = joint_centre([row.joint_offset_m for camera, row in further if camera.arm.pixel_rad is None])
    arms = [
        arm
        if arm.pixel_rad is None or row.pose is None
        else lifted(arm, depth_by_points(arm, row.pose, row.clock, first))
        for arm, row in ((each.arm, row) for each, row in further)
    ]
    begin, rows_of = 0, [row for _, row in further]
    for number, (arm, row) in enumerate(zip([first, *arms], [None, *rows_of], strict=True)):
        for part in batches(len(arm)):
            rows = place_of[begin + part.start : begin + part.stop]
            points = np.asarray(arm.position[part])
            if row is not None and row.pose is not None:
                points = row.pose.to_first(points) + row.joint_offset_m
            position[rows] = points - mean_m
            state[rows] = arm.state[part]
            camera[rows] = number
        begin += len(arm)
    origins = [np.full(3, np.nan), *(_origin(arm, row) for arm, row in zip(arms, rows_of, strict=True))]
    rays = np.array(origins) if np.isfinite(origins).any() else None
    return JointTracks(first.name, t[order], position, state, camera, ray_origin_m=rays)


def _origin(arm: JointTracks, row: RigCamera) -> FloatArray:
    """Where a camera's rays begin in {K}, nan of one with depth."""
    if arm.ray_origin_m is None or row.pose is None:
        return np.full(3, np.nan)
    return row.pose.p_K_C_m


def _of_pixels(recording: Recording) -> tuple[Recording, CameraRig | None]:
    """A recording whose first camera has no depth: by the rays of several."""
    first, alone = recording.arm, replace(recording, cameras=())
    rows = [_by_rays(camera, first) for camera in recording.cameras]
    together = [
        (camera, row, row.pose)
        for camera, row in zip(recording.cameras, rows, strict=True)
        if row.takes_part and row.pose is not None
    ]
    if not together:
        left_out = "".join(f"; {row.name} was left out: {row.reason}" for row in rows)
        raise SolveError(
            f"{recording.name}: its cameras without depth do not agree on how far away the arm is; add a"
            " camera with depth, name places that are known, or take one of them alone with"
            f" --skeleton{left_out}"
        )
    here = CameraPose(np.eye(3), np.zeros(3), 0.0, 0.0)
    camera, row, pose = together[0]
    backwards = RelativeClock(-row.clock.offset_s, sigma_s=row.clock.sigma_s)
    deep_first = lifted(first, depth_by_rays(first, here, backwards, camera.arm, pose)[0])
    lifted_cameras = [
        (each.with_arm(lifted(each.arm, depth_by_rays(each.arm, place, row.clock, first, here)[0])), row)
        for each, row, place in together
    ]
    arm = _joined(deep_first, lifted_cameras)
    origins = np.array([np.zeros(3), *(_origin(c.arm, row) for c, row in lifted_cameras)])
    rig = CameraRig((first_camera(FIRST_CAMERA), *rows))
    return replace(alone, arm=replace(arm, ray_origin_m=origins)), rig


def _by_rays(camera: Camera, first: JointTracks) -> RigCamera:
    """A camera beside a first one without depth: its place has to be known, its clock is found."""
    if camera.arm.pixel_rad is None or camera.pose is None:
        reason = "its pose is unknown, and cameras without depth do not show it"
        if camera.arm.pixel_rad is None:
            reason = "it sees depth and the first camera does not: name it as the first one"
        return RigCamera(camera.name, reason=reason)
    clock, misfit_m = clock_of_known_place(camera, first)
    if not np.isfinite(misfit_m):
        reason = f"it never sees the arm together with {FIRST_CAMERA}"
        return RigCamera(camera.name, camera.pose, reason=reason)
    reason = ""
    if misfit_m > RAYS_M:
        reason = (
            f"its rays pass {FIRST_CAMERA}'s by {100 * misfit_m:.0f} cm, whatever its clock: it was moved"
            " since the calibration, is mirrored, or saw another person"
        )
    together_s = overlap(first, camera.arm, clock).length_s
    return RigCamera(camera.name, camera.pose, clock, misfit_m=misfit_m, together_s=together_s, reason=reason)
