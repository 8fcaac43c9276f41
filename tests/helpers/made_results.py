"""Results made by hand, with every kind of missing answer, and their comparison."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np

from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.measurements.visibility import Gap, Reason
from smoother.recording import JOINTS, JointTracks
from smoother.result import Estimates, FrameResiduals, Recovery

ZERO = 1_700_000_000 * 10**9


def recovery(count: int = 400, seed: int = 0, side: str = "right", origin_ns: int = ZERO) -> Recovery:
    rng = np.random.default_rng(seed)
    t = np.rint((0.1234567 + np.arange(count) / 100) * 1e9) / 1e9
    frames = np.rint(np.arange(0, t[-1], 1 / 30) * 1e9) / 1e9
    quaternion = rng.normal(size=(count, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    root = rng.normal(size=(count, 6, 6))
    covariance = 1e-4 * root @ root.transpose(0, 2, 1)
    position, velocity = rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
    # No answer in samples 5 to 8, no orientation from 20 to 29, no stated uncertainty in 40.
    nothing = slice(5, 9)
    for values in (position, velocity, quaternion, covariance):
        values[nothing] = np.nan
    quaternion[20:30], covariance[20:30, 3:], covariance[20:30, :, 3:] = np.nan, np.nan, np.nan
    covariance[40] = np.nan
    velocity[50] = np.nan
    speed = covariance[:, :3, :3].copy()
    speed[50] = np.nan
    camera = rng.normal(size=(len(frames), len(JOINTS), 3))
    state = rng.integers(0, 3, (len(frames), len(JOINTS))).astype(np.int8)
    camera[state == 0] = np.nan
    residual, used = rng.normal(size=camera.shape), rng.random(state.shape) > 0.5
    reason = (rng.random(state.shape) > 0.9).astype(np.uint8)
    residual[:, 4], used[:, 4], reason[:, 4] = np.nan, False, 0
    joints = {joint: rng.normal(size=(count, 3)) for joint in JOINTS[:4]}
    joints["hand"][7:20] = np.nan
    return Recovery(
        method="graph",
        t_s=t,
        occluded=(t % 2) < 0.7,
        position=position,
        quaternion=quaternion,
        velocity=velocity,
        pose_covariance=covariance,
        velocity_covariance=speed,
        joints=joints,
        joint_covariance={joint: 0.5 * covariance[:, :3, :3] for joint in joints},
        gaps=(Gap(0.1, 0.7, open_start=True), Gap(2.0, 2.7)),
        calibration=ArmCalibration(
            side,
            {"elbow": LeverArm(np.array([0.0, -0.2, 0.0]), np.full(3, 0.01))},
            Length(0.3, 0.01),
            np.eye(3),
            None,
            np.array([1e-3, 0, 0]),
        ),
        gravity_direction=np.array([0.0, -1.0, 0.0]),
        clock_offset_s=-0.04,
        clock_offset_sigma_s=float("nan"),
        arm=JointTracks("/body", frames, camera, state),
        residuals=FrameResiduals(frames, residual, used, reason, (Reason(""), Reason("far from the arm"))),
        origin_ns=origin_ns,
        side=side,
        name="rec.mcap",
        notes=("A note.",),
        config={"camera": {"joint_sigma_m": 0.01}},
        estimates=Estimates.from_plain({"biases": [1.0, 2.0], "rounds": 3, "joint_bias_sigma_m": 0.004}),
    )


def assert_same(one: object, other: object, name: str = "", exact: bool = False) -> None:
    """The same, floats to rounding but for stamps, poses and residuals, or all of them bit by bit."""
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray)
        assert one.shape == other.shape, name
        if one.dtype.kind == "f":
            exact |= name.split(".")[-1] in ("t_s", "position", "quaternion", "pose_covariance", "residual")
            np.testing.assert_allclose(other, one, rtol=0 if exact else 1e-12, atol=0 if exact else 1e-14)
        else:
            np.testing.assert_array_equal(one, other, err_msg=name)
    elif is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{name}.{field.name}", exact)
    elif isinstance(one, dict):
        assert isinstance(other, dict) and list(one) == list(other), name
        for key in one:
            assert_same(one[key], other[key], f"{name}.{key}", exact)
    elif isinstance(one, tuple | list):
        assert isinstance(other, tuple | list) and len(one) == len(other), name
        for a, b in zip(one, other, strict=True):
            assert_same(a, b, name, exact)
    elif isinstance(one, float) and np.isnan(one):
        assert np.isnan(other)  # type: ignore[call-overload]
    else:
        assert one == other, name
