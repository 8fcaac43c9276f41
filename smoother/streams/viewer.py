"""The session in Rerun while it lasts: what `unocclude view` shows of a result, step by step."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..io.export.rrd import ArmPicture, level_scene, rerun_module, views
from ..live.answers import LiveState
from ..recording import JOINTS, JointTracks
from ..result import Recovery
from .arrivals import LiveStep, Rows, SourceInfo

#: Shortest interval between two drawings of an arm, s, and how many of the last events are shown.
_DRAWN_EACH_S, _EVENTS = 0.05, 20


class RerunView:
    """Shows what the arms do *now* in a viewer that listens at an address."""

    def __init__(self, infos: Sequence[SourceInfo], address: str) -> None:
        self._infos, self._rr = infos, rerun_module()
        self._stream: Any = self._rr.RecordingStream("unocclude live", send_properties=False)
        self._stream.connect_grpc(address)
        level_scene(self._rr, self._stream, infos[0].down)
        self._steps: dict[int, list[LiveStep]] = {}  # of each arm, those that are not drawn yet
        self._events: deque[str] = deque(maxlen=_EVENTS)
        self._shown: dict[int, ArmPicture] = {}

    def send(self, step: LiveStep) -> None:
        """Show what was answered of an arm since it was drawn last."""
        rr, now_s = self._rr, step.output.now_s
        if step.events:
            self._events += (f"{now_s:.1f} s: {event}" for event in step.events)
            text = "\n\n".join(reversed(self._events))
            self._stream.log("notes", rr.TextDocument(text, media_type="text/markdown"), static=True)
        steps = self._steps.setdefault(step.arm, [])
        steps.append(step)
        if now_s - steps[0].output.now_s < _DRAWN_EACH_S:
            return
        del self._steps[step.arm]
        info, number = self._infos[step.arm], step.arm if len(self._infos) > 1 else None
        recovery, is_new = recovery_of(info, steps), step.arm not in self._shown
        if not len(recovery) and is_new:  # which joints and angles there are shows with the first answer
            return
        picture = ArmPicture(rr, self._stream, recovery, info.side or "arm", number, is_new)
        picture.log()
        if is_new:
            self._shown[step.arm] = picture
            self._stream.send_blueprint(views(rr, list(self._shown.values())))

    def close(self) -> None:
        """Send what waits."""
        self._stream.disconnect()


def recovery_of(info: SourceInfo, steps: Sequence[LiveStep]) -> Recovery:
    """What some steps of an arm answered of the present, and the frames that came, as a recovery."""
    estimates = [step.output.now for step in steps if step.output.now is not None]
    joints = [joint for joint in JOINTS if all(joint in each.joints for each in estimates)]
    offset_s = float(np.nan_to_num(steps[-1].output.clock_offset_s))
    frames = Rows.joined([step.frames for step in steps])
    arm = JointTracks(info.skeleton, np.empty(0), np.empty((0, 5, 3)), np.empty((0, 5), np.int8))
    if len(frames):
        arm = JointTracks(info.skeleton, frames.t_s + offset_s, frames["position"], frames["state"])

    def column(name: str, *shape: int, joint: str = "") -> FloatArray:
        values = [getattr(each, name) for each in estimates]
        return np.array([each[joint] if joint else each for each in values], float).reshape(-1, *shape)

    return Recovery(
        method="live",
        t_s=column("t_s"),
        occluded=np.array([each.state is not LiveState.VISIBLE for each in estimates], bool),
        position=column("position", 3),
        quaternion=column("quaternion", 4),
        velocity=column("velocity", 3),
        pose_covariance=column("pose_covariance", 6, 6),
        velocity_covariance=np.full((len(estimates), 3, 3), np.nan),
        joints={joint: column("joints", 3, joint=joint) for joint in joints},
        joint_covariance={joint: column("joint_covariance", 3, 3, joint=joint) for joint in joints},
        gaps=(),
        calibration=None,
        gravity_direction=np.full(3, np.nan) if info.down is None else info.down,
        clock_offset_s=0.0,
        clock_offset_sigma_s=0.0,
        arm=arm,
        origin_ns=info.origin_ns,
        side=info.side,
    )
