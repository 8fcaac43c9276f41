"""What is wrong with a camera's samples, in words: what was left out, and what contradicts even then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..array_types import BoolArray, IntArray
from ..linalg import runs
from ..measurements.visibility import Gap
from ..recording import JOINTS, JointState, Recording
from ..result import Recovery
from ..result.verdict import Finding, finding

#: Bones that are off by this share of their usual length, and by this much, m, are another body's.
OTHER_LENGTH, OTHER_LENGTH_M = 0.15, 0.035
#: Joints that move less than this, m, while by the rest they move this much more are guessed.
HELD_M, HELD_SHARE = 0.03, 4.0
#: Blocks farther apart than this, s, with nothing visible between are on both sides of a gap.
HIDDEN_S = 0.25

_ELBOW, _WRIST = (JOINTS.index(joint) for joint in ("elbow", "wrist"))


def camera_faults(
    excluded: BoolArray,  # bool (F,)
    contradicting: Sequence[tuple[float, float, int]],
    recovery: Recovery,
    recording: Recording,
    names: Sequence[str],
) -> Iterator[Finding]:
    """What was left out, and what contradicts even then."""
    frame_t = np.asarray(recovery.arm.t_s)
    for name, own in zip(names, recording.arm.rows_by_camera, strict=True):
        for run in _joined(excluded, recording, own):
            rows = own[run]
            start_s, end_s = float(frame_t[rows[0]]), float(frame_t[rows[-1]])
            looks = _looks_like(run, own, recovery, recording)
            what = f"from {start_s:.1f} to {end_s:.1f} s {name}'s joints contradict the IMU and the rest"
            yield finding("camera-left-out", f"{what}: {looks}; they were left out")
            interrupted = np.diff(frame_t[rows[excluded[rows]]], prepend=start_s).max() > HIDDEN_S
            from_s, to_s = _with_gaps(recovery.gaps, start_s, end_s)
            both_sides = interrupted or (start_s - from_s > HIDDEN_S and to_s - end_s > HIDDEN_S)
            for gap in _beside(recovery.gaps, start_s, end_s):
                if both_sides or gap.open_start or gap.open_end:
                    times = min(gap.start_s, start_s), max(gap.end_s, end_s)
                    where = "either" if both_sides else "that"
                    yield finding(
                        "gap-unconfirmed",
                        f"{what} ({looks}), and nothing on {where} side confirms the answer",
                        times,
                    )
    for start_s, end_s, camera in sorted(contradicting):
        yield finding(
            "camera-contradicted",
            f"from {start_s:.1f} to {end_s:.1f} s {names[camera]}'s joints and the IMU contradict each other,"
            " and nothing shows which is right",
            _with_gaps(recovery.gaps, start_s, end_s),
        )


def _beside(gaps: Sequence[Gap], start_s: float, end_s: float) -> list[Gap]:
    """The gaps that rest on what the camera saw between two times."""
    return [gap for gap in gaps if gap.start_s <= end_s + 0.2 and gap.end_s >= start_s - 0.2]


def _with_gaps(gaps: Sequence[Gap], start_s: float, end_s: float) -> tuple[float, float]:
    """Times widened to the gaps beside them."""
    near = _beside(gaps, start_s, end_s)
    return min([start_s, *(gap.start_s for gap in near)]), max([end_s, *(gap.end_s for gap in near)])


def _joined(frames: BoolArray, recording: Recording, own: IntArray) -> list[slice]:
    """Runs of a camera's frames that are left out; runs with nothing visible between them are one."""
    frames = frames[own]
    visible = (recording.arm.state[own][:, [_ELBOW, _WRIST]] == JointState.TRACKED).all(axis=1) & ~frames
    joined: list[slice] = []
    for run in runs(frames):
        if joined and not visible[joined[-1].stop : run.start].any():
            joined[-1] = slice(joined[-1].start, run.stop)
        else:
            joined.append(run)
    return joined


def _looks_like(rows: slice, own: IntArray, recovery: Recovery, recording: Recording) -> str:
    """What a block of a camera's frames that is wrong looks like."""
    arm = recording.arm.select(own)
    both = (arm.state[:, [_ELBOW, _WRIST]] == JointState.TRACKED).all(axis=1)
    length = np.linalg.norm(arm.joint("wrist") - arm.joint("elbow"), axis=1)
    inside = np.zeros(len(arm), bool)
    inside[rows] = True
    here, rest = length[both & inside], length[both & ~inside]
    if len(here) and len(rest):
        usual_m, here_m = float(np.median(rest)), float(np.median(here))
        if abs(here_m - usual_m) > max(OTHER_LENGTH * usual_m, OTHER_LENGTH_M):
            return (
                f"the forearm is {100 * here_m:.0f} cm long there, where it is {100 * usual_m:.0f} cm"
                " otherwise: another person's body, or joints that the tracker guessed"
            )
    t = np.asarray(recovery.arm.t_s)[own][rows]
    seen = both[rows]
    if seen.sum() > 5 and "wrist" in recovery.joints:
        seen_m = np.ptp(arm.joint("wrist")[rows][seen], axis=0)
        span = slice(*np.searchsorted(recovery.t_s, [t[0], t[-1]]).tolist())
        answer_m = np.ptp(recovery.joints["wrist"][span], axis=0)
        moved, should = float(np.linalg.norm(seen_m)), float(np.linalg.norm(answer_m))
        if moved < HELD_M and should > HELD_SHARE * max(moved, 0.01):
            return "the joints hardly move while the IMU does: guessed by the tracker"
    return "another person's body, the other arm, or joints that the tracker guessed"
