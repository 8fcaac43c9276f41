"""Recordings that the tests make."""

from __future__ import annotations

import numpy as np

from smoother.recording import JOINTS, CameraFrame, ImuStream, JointState, JointTracks, Recording, Truth


def swing(t: np.ndarray, rate: float = 1.0, phase: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Elbow, wrist (T, 3) and gyro (T, 3) of a forearm that swings about z at a varying pace."""
    angle = np.sin(rate * t + phase) + 0.5 * np.sin(2.3 * rate * t + 2 * phase)
    pace = rate * np.cos(rate * t + phase) + 0.5 * 2.3 * rate * np.cos(2.3 * rate * t + 2 * phase)
    elbow = np.tile([0.1, 0.2, 2.0], (len(t), 1))
    wrist = elbow + 0.25 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return elbow, wrist, np.stack([0 * pace, 0 * pace, pace], axis=1)


def make(
    seconds: float = 8.0, rate: float = 1.0, side: str = "right", origin_ns: int = 1_700_000_000 * 10**9
) -> Recording:
    """A recording of a swinging forearm with a gap, inferred samples, truth and a base IMU."""
    rng = np.random.default_rng(1)
    t, frames = np.arange(0.003, seconds, 0.01), np.arange(0.0101, seconds, 1 / 30)
    _, wrist, gyro = swing(t, rate)
    acc = np.tile([0.0, 9.81, 0.0], (len(t), 1)) + rng.normal(0, 0.02, (len(t), 3))
    elbow_seen, wrist_seen, _ = swing(frames, rate)
    position = np.full((len(frames), 5, 3), np.nan)
    state = np.zeros((len(frames), 5), np.int8)
    position[:, 0] = [0.1, 0.5, 2.0]
    position[:, 1], position[:, 2] = elbow_seen, wrist_seen
    state[:, :3] = JointState.TRACKED
    hidden = (frames > 0.5 * seconds) & (frames < 0.6 * seconds)
    state[hidden, 1:3], position[hidden, 1:3] = JointState.NOT_TRACKED, np.nan
    state[10, 2] = JointState.INFERRED
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
    quaternion[20:25] = np.nan
    truth = Truth(t, wrist.copy(), quaternion, t > 1.0, {"elbow": swing(t, rate)[0]})
    truth.position[30:33] = np.nan
    return Recording(
        imu=ImuStream(
            f"/imu/forearm_{side}" if side else "/imu/forearm", t, acc, gyro, rng.normal(size=(len(t), 3))
        ),
        arm=JointTracks("/skeleton", frames, position, state),
        side=side,
        camera_frame=CameraFrame.KINECT,
        gravity_hint=np.array([0.0, -1.0, 0.0]),
        base_imu=ImuStream("/imu/base", t, acc + 0.1, 0.01 * gyro),
        truth=truth,
        origin_ns=origin_ns,
        name="made",
        notes=("A note.",),
    )


def plain_texts() -> dict[str, str]:
    recording = make()
    imu = ["t_s,ax,ay,az,gx,gy,gz"]
    for t, acc, gyro in zip(recording.imu.t_s, recording.imu.acc, recording.imu.gyro, strict=True):
        imu.append(",".join(f"{value:.9f}" for value in (t, *acc, *gyro)))
    rows = ["t_s,joint,x,y,z,state"]
    words = {JointState.TRACKED: "tracked", JointState.INFERRED: "inferred"}
    for t, position, state in zip(
        recording.arm.t_s, recording.arm.position, recording.arm.state, strict=True
    ):
        for i, joint in enumerate(JOINTS[:3]):
            if state[i]:
                cells = ",".join(f"{value:.9f}" for value in position[i])
                rows.append(f"{t:.9f},{joint}_right,{cells},{words[JointState(state[i])]}")
            else:
                rows.append(f"{t:.9f},{joint}_right,,,,not_tracked")
    return {
        "recording": (
            '[camera]\nframe = "kinect"\ngravity = [0, -2, 0]\nskeleton = "skeleton.csv"\n'
            '[imu.forearm_right]\nfile = "imu.csv"\n[truth]\nfile = "truth.csv"\n'
        ),
        "skeleton": "\n".join(rows) + "\n",
        "imu": "\n".join(imu) + "\n",
        "truth": "t_s,x,y,z,qw,qx,qy,qz\n0.1,1,2,3,,,,\n0.2,1,2,3,1,0,0,0\n",
    }
