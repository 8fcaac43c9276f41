"""The Lab Streaming Layer: the library `pylsl`, an extra, and the arm as streams.

The library announces all streams of a program alike, and inlets have to see the network: outlets are in a
process of their own, whose settings keep them on this computer; it ends with this one.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from configparser import ConfigParser, Error
from contextlib import suppress
from functools import cache
from io import StringIO
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from pathlib import Path
from queue import Full
from types import ModuleType
from typing import Any

import numpy as np

from ..angles.definitions import arm_angles
from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..live.answers import LiveEstimate, LiveOutput, LiveState
from ..recording import JOINTS
from ..runtime.packages import extra_module
from ..runtime.pool import prepare_worker, starting_processes
from .arrivals import LiveStep, SourceInfo

#: Where liblsl looks for settings of the user's own.
_SETTINGS = "lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg"
#: The library writes lines of its log to the terminal; -3 is the least.
_NO_LOG = "[log]\nlevel = -3\n"


def user_settings() -> Path | None:
    """The file with the user's own settings of liblsl; None without one."""
    named = os.environ.get("LSLAPICFG")
    if named:
        return Path(named)
    return next((path for path in (Path(file).expanduser() for file in _SETTINGS) if path.exists()), None)


@cache
def lsl_module() -> ModuleType:
    """The package `pylsl`, which keeps silent on the terminal unless the user has settings for it."""
    try:
        pylsl = extra_module("pylsl", "pylsl", "live")
    except (RuntimeError, OSError) as error:
        raise UnoccludeError(
            "pylsl is installed without the library liblsl; install a wheel of pylsl that brings it"
            " (`pip install -U pylsl`), or liblsl itself, and name its file in PYLSL_LIB"
        ) from error
    if user_settings() is None and hasattr(pylsl, "set_config_content"):
        pylsl.set_config_content(_NO_LOG)
    return pylsl


#: Angles that are sent; that of the forearm is above level.
ANGLES = ("elbow_flexion", "shoulder_elevation", "forearm_elevation")
#: A step for slopes, m.
_STEP_M = 1e-4


def live_angles(estimate: LiveEstimate, down: FloatArray | None) -> dict[str, tuple[float, float]]:
    """Angles and their sigmas, degrees, by name; errors of joints count as independent: the safe side."""
    joints: list[str] = [joint for joint in ("shoulder", "elbow", "wrist") if joint in estimate.joints]
    # the arm, and once more with each coordinate of each joint moved by a step
    moved = np.concatenate([np.zeros((1, 3 * len(joints))), _STEP_M * np.eye(3 * len(joints))])
    at = {joint: estimate.joints[joint] + moved[:, 3 * k : 3 * k + 3] for k, joint in enumerate(joints)}
    angles = arm_angles(at, len(moved), down=down)
    if down is not None and {"elbow", "wrist"} <= at.keys():
        fore = at["wrist"] - at["elbow"]
        angles["forearm_elevation"] = np.degrees(
            np.arctan2(-fore @ down, np.linalg.norm(np.cross(fore, down), axis=1))
        )
    found = {}
    for name in ANGLES:
        if name in angles and np.isfinite(angles[name]).all():
            slopes = ((angles[name][1:] - angles[name][0]) / _STEP_M).reshape(-1, 3)
            covariances = (estimate.joint_covariance[joint] for joint in joints)
            variance = sum(g @ C @ g for g, C in zip(slopes, covariances, strict=True))
            found[name] = float(angles[name][0]), float(np.sqrt(variance))
    return found


#: What the channel `state` says.
STATES = {LiveState.CALIBRATING: 0, LiveState.VISIBLE: 1, LiveState.GAP: 2, LiveState.LOST: 3}


class LslOutlet:
    """Sends `now` as a stream NAME and `settled` as NAME_settled, of type MoCap, a sample a step."""

    def __init__(self, name: str, info: SourceInfo) -> None:
        self._info, self._side = info, f"_{info.side}" if info.side else ""
        self._outlets = {"now": self._outlet(name), "settled": self._outlet(f"{name}_settled")}

    def send(self, output: LiveOutput) -> None:
        """Send what a step answered."""
        start_s = self._info.lsl_start_s
        if start_s is None:  # a recording is played: the step's present is now
            start_s = lsl_module().local_clock() - output.now_s
        for kind, outlet in self._outlets.items():
            estimate: LiveEstimate | None = getattr(output, kind)
            t_s = output.now_s if estimate is None else estimate.t_s
            outlet.push_sample([float(value) for *_, value in self._columns(output, estimate)], start_s + t_s)

    def _outlet(self, name: str) -> Any:
        lsl = lsl_module()
        columns = list(self._columns(LiveOutput(0.0, LiveState.CALIBRATING), None))
        stream = lsl.StreamInfo(
            name, "MoCap", len(columns), lsl.IRREGULAR_RATE, lsl.cf_double64, f"unocclude-{name}"
        )
        described = stream.desc().append_child("channels")
        for *texts, _ in columns:
            channel = described.append_child("channel")
            for key, text in zip(("label", "marker", "type", "unit"), texts, strict=True):
                if text:
                    channel.append_child_value(key, text)
        acquisition = stream.desc().append_child("acquisition")
        imu = next(iter(self._info.imus.values()))
        for key, text in (("manufacturer", "unocclude"), ("imu", imu), ("skeleton", self._info.skeleton)):
            acquisition.append_child_value(key, text)
        return lsl.StreamOutlet(stream)

    def _columns(
        self, output: LiveOutput, estimate: LiveEstimate | None
    ) -> Iterator[tuple[str, str, str, str, float]]:
        """Label, marker, type, unit and value of every channel; nan without an estimate."""
        side, nothing = self._side, np.full(4, np.nan)
        places: dict[str, tuple[FloatArray, FloatArray]] = {}
        turn, sigma_deg, since_s, lag_s = nothing, np.nan, 0.0, 0.0
        angles: dict[str, tuple[float, float]] = {}
        if estimate is not None:
            places = {joint: (at, estimate.joint_covariance[joint]) for joint, at in estimate.joints.items()}
            places["imu"] = estimate.position, estimate.pose_covariance[:3, :3]
            turn, sigma_deg, lag_s = estimate.quaternion, estimate.sigma_deg, output.now_s - estimate.t_s
            since_s = 0.0 if estimate.since_s is None else estimate.t_s - estimate.since_s
            angles = live_angles(estimate, self._info.down)
        for marker in ("imu", *JOINTS):
            place, covariance = places.get(marker, (nothing, np.full((3, 3), np.nan)))
            for axis, value in zip("XYZ", place, strict=False):
                yield f"{marker}{side}_{axis.lower()}", marker + side, f"Position{axis}", "meters", value
            # on the worst axis
            yield f"{marker}{side}_sigma", "", "Sigma", "meters", float(np.sqrt(np.diag(covariance).max()))
        for axis, letter, value in zip("wxyz", "ABCD", turn, strict=True):
            yield f"imu{side}_q{axis}", "imu" + side, f"Orientation{letter}", "quaternion", value
        yield f"imu{side}_sigma_deg", "", "Sigma", "degrees", sigma_deg
        state = STATES[output.state if estimate is None else estimate.state]
        yield "state", "", "State", "0 calibrating, 1 visible, 2 gap, 3 lost", float(state)
        yield "gap", "", "Time", "seconds", since_s
        yield "lag", "", "Time", "seconds", lag_s
        for name in ANGLES:
            for suffix, kind, value in zip(
                ("", "_sigma"), ("Angle", "Sigma"), angles.get(name, nothing[:2]), strict=True
            ):
                yield f"{name}{side}{suffix}", "", kind, "degrees", value
        is_trusted = estimate is not None and output.trusted
        yield "trusted", "", "State", "1 trusted, 0 with care or no answer", float(is_trusted)


#: The process may take this long to begin, and to end, s.
_BEGINS_S, _ENDS_S = 60.0, 3.0
#: This many answers wait for it at most; one that comes too late for that is not sent.
_MOST_WAITING = 60
#: The library's settings that keep its announcements to this computer.
_LOCAL = {
    "multicast": {"ResolveScope": "machine", "ListenAddress": "127.0.0.1"},
    "ports": {"IPv6": "disable"},
}


class LslSender:
    """Sends the arms of a session, from a process that only this computer can find, or the whole network."""

    def __init__(self, names: Sequence[str], infos: Sequence[SourceInfo], network: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self._waiting: Queue[tuple[int, LiveOutput] | None] = context.Queue(_MOST_WAITING)
        ready = context.Event()
        arguments = (names, infos, network, self._waiting, ready)
        self._process = context.Process(target=_send, args=arguments, name="lsl-out", daemon=True)
        with starting_processes():
            self._process.start()
        for _ in range(round(10 * _BEGINS_S)):
            if ready.wait(0.1) or not self._process.is_alive():
                break
        if not ready.is_set():
            self.close()
            raise UnoccludeError("the process that sends --lsl-out cannot be started; leave --lsl-out out")

    def send(self, step: LiveStep) -> None:
        """Hand over what a step answered; never waits."""
        with suppress(Full):
            self._waiting.put_nowait((step.arm, step.output))

    def close(self) -> None:
        """End the process, and let all receivers go."""
        with suppress(Full):
            self._waiting.put_nowait(None)
        self._process.join(_ENDS_S)
        self._process.kill()
        self._process.join(_ENDS_S)
        self._waiting.cancel_join_thread()  # what was not sent is not waited for
        self._waiting.close()


def _send(
    names: Sequence[str],
    infos: Sequence[SourceInfo],
    network: bool,
    waiting: Queue[tuple[int, LiveOutput] | None],
    ready: Event,
) -> None:
    """The process: outlets that send what comes."""
    prepare_worker()
    if not network:
        lsl_module().set_config_content(local_settings(user_settings()))
    outlets = [LslOutlet(*each) for each in zip(names, infos, strict=True)]
    ready.set()
    while (job := waiting.get()) is not None:
        outlets[job[0]].send(job[1])


def local_settings(file: Path | None) -> str:
    """Settings of the library that keep to this computer; all else as a user's file says."""
    parser = ConfigParser(interpolation=None, strict=False, inline_comment_prefixes=(";",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # names of settings have capitals
    with suppress(OSError, Error, UnicodeDecodeError):
        if file is not None:
            parser.read_string(file.read_text("utf-8"))
    if not parser.has_option("log", "level"):
        parser.read_dict({"log": {"level": "-3"}})
    parser.read_dict(_LOCAL)
    text = StringIO()
    parser.write(text)
    return text.getvalue()
