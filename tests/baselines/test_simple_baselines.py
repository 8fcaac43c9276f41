"""Baselines without a model: odd scenes; `linear-drift` as published."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import solved_arm

from smoother.array_types import FloatArray
from smoother.baselines.registry import recover
from smoother.baselines.scene import Scene, between, scenes_of
from smoother.baselines.simple import (
    boundary,
    camera_only,
    hold,
    linear_drift,
)
from smoother.linalg import interpolate
from smoother.measurements.visibility import Gap
from smoother.recording import JOINTS

FRAME_S = 1.0 / 30.0


@pytest.fixture(scope="module")
def behind() -> Scene:
    it = solved_arm("white", 3, protocol="behind", repetitions=1)
    (scene,) = scenes_of(it.recording, it.recovery)
    return scene


def test_camera_only_by_equation_16(behind: Scene):
    """In frames where the camera states both joints: the paper's formula from its own d_se and d_sw."""
    levers = behind.calibration.lever_arms
    elbow, wrist = levers["elbow"].position_m, levers["wrist"].position_m
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    d_se, d_sw = float(-elbow @ along), float(wrist @ along)
    L, T = (behind.camera_joints[:, JOINTS.index(joint)] for joint in ("elbow", "wrist"))
    D = L + d_se / (d_sw + d_se) * (T - L)
    known = np.isfinite(D).all(axis=1)
    frames = behind.frame_t[known]
    at_frames = replace(behind, imu=replace(behind.imu, t_s=frames))
    np.testing.assert_allclose(camera_only(at_frames).position, D[known], atol=1e-12)


def test_camera_only_takes_guesses_and_bridges_silence(behind: Scene):
    gap = behind.gaps[0]
    hidden = (behind.frame_t > gap.start_s) & (behind.frame_t < gap.end_s)
    camera_joints = behind.camera_joints.copy()
    camera_joints[hidden] = np.array([1.0, 2.0, 3.0])
    inside = (behind.t > gap.start_s + FRAME_S) & (behind.t < gap.end_s - FRAME_S)
    np.testing.assert_allclose(
        camera_only(replace(behind, camera_joints=camera_joints)).position[inside],
        [[1.0, 2.0, 3.0]] * inside.sum(),
    )
    camera_joints[hidden] = np.nan
    line = camera_only(replace(behind, camera_joints=camera_joints)).position[inside]
    assert np.abs(np.diff(line, n=2, axis=0)).max() < 1e-9


def test_camera_only_with_fewer_joints(behind: Scene):
    strap = np.full_like(behind.camera_joints, np.nan)
    strap[:, JOINTS.index("strap")] = [0.1, 0.2, 2.0]
    bare = replace(behind, camera_joints=strap, calibration=replace(behind.calibration, lever_arms={}))
    np.testing.assert_allclose(camera_only(bare).position, np.tile([0.1, 0.2, 2.0], (len(behind.t), 1)))
    nothing = replace(behind, camera_joints=np.full_like(strap, np.nan))
    assert np.isnan(camera_only(nothing).position).all()


def test_hold_stands_still_in_a_gap(behind: Scene):
    path = hold(behind)
    for gap in behind.gaps:
        inside = behind.occluded & (behind.t > gap.start_s) & (behind.t < gap.end_s)
        last = behind.point[np.searchsorted(behind.frame_t, gap.start_s)]
        np.testing.assert_allclose(path.position[inside], np.tile(last, (inside.sum(), 1)))
        assert (path.R_K_A[inside] == path.R_K_A[inside][0]).all()
    seen = ~behind.occluded
    np.testing.assert_allclose(
        path.position[seen],
        between(behind.frame_t, behind.point, behind.t)[seen],
    )


PEOPLE = (50, 51, 52)


def slow(scene: Scene, gap: Gap, boundary_s: float) -> tuple[FloatArray, FloatArray]:
    """II-K and II-L as they are written, sample by sample; rows of the scene and positions."""
    ends = []
    for at, start_s, end_s in (
        (gap.start_s, gap.start_s - boundary_s - 1e-9, gap.start_s),
        (gap.end_s, gap.end_s, gap.end_s + boundary_s + 1e-9),
    ):
        near = scene.visible & (scene.frame_t >= start_s) & (scene.frame_t <= end_s)
        slope, place = np.polyfit(scene.frame_t[near] - at, scene.point[near], 1)
        ends.append((place, slope))
    (p0, v0), (pn, vn) = ends
    rows = [k for k, t in enumerate(scene.t) if gap.start_s < t < gap.end_s]
    times = [gap.start_s, *(scene.t[k] for k in rows), gap.end_s]
    net = interpolate(scene.t, scene.acceleration, np.array(times))

    def spread(first: FloatArray, rates: FloatArray, last: FloatArray) -> FloatArray:
        values = [first]
        for k in range(1, len(times)):
            values.append(values[-1] + 0.5 * (rates[k - 1] + rates[k]) * (times[k] - times[k - 1]))
        share = [(t - times[0]) / (times[-1] - times[0]) for t in times]
        return np.array([x + (last - values[-1]) * u for x, u in zip(values, share, strict=True)])

    position = spread(p0, spread(v0, net, vn), pn)
    elbow, answer = scene.calibration.lever_arms["elbow"].position_m, []
    for k, p in zip(rows, position[1:-1], strict=True):
        # the elbow at the upper arm's length from the shoulder, by the shortest way
        S, e = scene.shoulder[k], p + scene.R_K_A[k] @ elbow
        wanted = S + scene.calibration.upper_arm.value_m * (e - S) / np.linalg.norm(e - S)
        answer.append(p + wanted - e)
    return np.array(rows), np.array(answer)


@pytest.mark.parametrize("boundary_s", [0.5, 0.2])
def test_the_published_steps(behind: Scene, boundary_s: float):
    scene = behind
    path = linear_drift(scene, boundary_s)
    assert len(scene.gaps) >= 2
    for gap in scene.gaps:
        rows, expected = slow(scene, gap, boundary_s)
        np.testing.assert_allclose(path.position[rows], expected, atol=1e-9)


@pytest.mark.slow
def test_errors_of_the_papers_size():
    """4.07 cm rms and 14.1 cm at most, each within a factor of 2.5, over three people."""
    squares, largest = [], []
    for seed in PEOPLE:
        it = solved_arm("white", seed, protocol="behind", repetitions=1)
        found = recover(it.recording, it.recovery, "linear-drift")
        off = found.position - it.recording.truth.position
        error = np.linalg.norm(off, axis=1)[it.recovery.occluded]
        squares.append(np.nanmean(error**2))
        largest.append(float(np.nanmax(error)))
    assert 0.0407 / 2.5 < np.sqrt(np.mean(squares)) < 0.0407 * 2.5
    assert 0.141 / 2.5 < np.mean(largest) < 0.141 * 2.5


def test_one_sided_gaps_are_integrated_from_the_side_that_is_there(behind: Scene):
    """Under a constant acceleration and without a shoulder: the parabola that the ends imply, exactly."""
    scene = behind
    a = np.array([0.3, -0.2, 0.1])
    t = scene.t
    place = np.array([0.1, 0.2, 2.0]) + np.outer(t, [0.2, 0.1, 0.0])
    frames = np.array([0.1, 0.2, 2.0]) + np.outer(scene.frame_t, [0.2, 0.1, 0.0])
    middle = 0.5 * (t[0] + t[-1])
    for open_side in ("start", "end"):
        seen = scene.frame_t > middle if open_side == "start" else scene.frame_t < middle
        last = float(scene.frame_t[seen][0 if open_side == "start" else -1])
        gap = Gap(float(t[0]), last, open_start=True)
        if open_side == "end":
            gap = Gap(last, float(t[-1]), open_end=True)
        bare = replace(
            scene,
            point=np.where(seen[:, None], frames, np.nan),
            acceleration=np.tile(a, (len(t), 1)),
            gaps=(gap,),
            calibration=replace(scene.calibration, upper_arm=None),
        )
        path = linear_drift(bare)
        inside = bare.occluded
        expected = place + 0.5 * a * (t - last)[:, None] ** 2
        np.testing.assert_allclose(path.position[inside], expected[inside], atol=1e-6)
        assert any("without the shoulder" in note for note in path.notes)


@pytest.mark.parametrize(
    "start_s, end_s, at_end, place, velocity",
    [(0.9, 1.2, True, 0.2, 1.0), (1.0, 1.3, False, 0.0, 1.0), (1.15, 1.25, True, 0.2, 0.0)],
)
def test_boundaries_with_hardly_anything_to_see(start_s, end_s, at_end, place, velocity):
    t, x = np.array([1.0, 1.1, 1.2]), np.outer([0.0, 0.1, 0.2], [1.0, 0.0, 0.0])
    found = boundary(t, x, start_s, end_s, at_end)
    np.testing.assert_allclose(found, ([place, 0, 0], [velocity, 0, 0]), atol=1e-12)
    assert boundary(t, x, 2.0, 3.0) is None
