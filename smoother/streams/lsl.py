"""The Lab Streaming Layer: the library `pylsl`, an extra; a session's source and the arm as streams.

The library announces all streams of a program alike, and looks for streams as far as it announces its own:
what is sent to this computer only goes with streams that this computer sends. A stream that is lost is
connected again when it is back.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from configparser import ConfigParser, Error
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..angles.definitions import arm_angles
from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS
from ..errors import UnoccludeError
from ..io.recording.streams import named_side
from ..live.answers import LiveEstimate, LiveOutput, LiveState
from ..recording import JOINTS
from ..runtime.packages import extra_module
from ..runtime.printable import printable
from .arrivals import STEP_OF_IMU_S, Arrivals, LiveStep, Rows, SourceInfo, StampSteps
from .channels import ImuChannels, SkeletonChannels, StreamLabels, belongs, is_accelerometer

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


#: The library's settings that keep its announcements to this computer.
_LOCAL = {
    "multicast": {"ResolveScope": "machine", "ListenAddress": "127.0.0.1"},
    "ports": {"IPv6": "disable"},
}


def stay_here() -> None:
    """Find and announce streams on this computer only; before the first of them."""
    lsl_module().set_config_content(local_settings(user_settings()))


class LslSender:
    """Sends the arms of a session."""

    def __init__(self, names: Sequence[str], infos: Sequence[SourceInfo]) -> None:
        self._outlets = [LslOutlet(*each) for each in zip(names, infos, strict=True)]

    def send(self, step: LiveStep) -> None:
        """Send what a step answered; the library never waits for its receivers."""
        self._outlets[step.arm].send(step.output)

    def close(self) -> None:
        """Let all receivers go."""
        self._outlets.clear()


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


def listed(streams: Sequence[Any]) -> str:
    """Names and types of streams, for a sentence."""
    names = sorted({f"{stream.name()} (type {stream.type() or 'none'})" for stream in streams})
    shown = [printable(name[:80]) for name in names[:8]]
    more = [f"and {len(names) - 8} more"] if len(names) > 8 else []
    return ", ".join([*shown, *more]) or "none"


#: Samples that are received together at most, and for how long the library holds them, s.
_MOST, _BUFFER_S = 4096, 120
#: How long a stream has to answer, all streams to be listed, and between two looks at what has come, s.
_ANSWERS_S, _LISTED_S, _LOOK_S = 1.0, 1.0, 0.002


class LslInlet:
    """Receives a stream, also after it was lost."""

    def __init__(self, option: str, wanted: str | None, types: tuple[str, ...], start_s: float = 0.0) -> None:
        self._option, self._wanted, self._types, self._start_s = option, wanted, types, start_s
        self.stream: Any = None
        self.labels: StreamLabels | None = None  # Of the stream, once it was connected
        self.correction_s, self.is_open = float("nan"), False
        self._inlet: Any = None
        self._lost = ""  # the stream that has ended, which the library lists for some seconds more
        self._came: list[Rows] = []
        self._events: list[str] = []

    @property
    def name(self) -> str:
        """What the stream that was found is called."""
        return printable(self.stream.name())

    @property
    def described(self) -> str:
        """Which stream is looked for, by its option."""
        if self._wanted is not None:
            return f"{self._option}{self._wanted}"
        return f"{self._option.strip(' -')} of type {self._types[0]}"

    def connect(self, there: Sequence[Any]) -> None:
        """Go on to connect with the stream that is meant, where it is among those that are there."""
        try:
            if self._inlet is None:
                if (found := self._matching([each for each in there if each.uid() != self._lost])) is None:
                    return
                # the library itself would wait for the same source_id for ever
                inlet = lsl_module().StreamInlet(found, max_buflen=_BUFFER_S, recover=False)
                self._take_down(inlet.info(_ANSWERS_S))
                self._inlet = inlet
            self.correction_s = self._inlet.time_correction(0.0)
            self._inlet.open_stream(_ANSWERS_S)  # last: what waits inside has no arrival of its own
            self.is_open = True
        except lsl_module().util.TimeoutError:
            return  # the library is at it
        except RuntimeError:
            self._lose()

    def receive(self) -> bool:
        """Take in what has come; whether anything has."""
        if not self.is_open:
            return False
        try:
            values, stamps = self._inlet.pull_chunk(timeout=0.0, max_samples=_MOST, as_numpy=True)
            if not len(stamps):
                return False
            with suppress(lsl_module().util.TimeoutError):  # the one before holds until there is a new one
                self.correction_s = self._inlet.time_correction(0.0)
        except RuntimeError:
            self._lose()
            return False
        t_s = np.asarray(stamps, float) + self.correction_s - self._start_s
        arrival_s = np.full(len(t_s), lsl_module().local_clock() - self._start_s)
        self._came.append(Rows(t_s, arrival_s, {"values": np.asarray(values)}))
        return True

    def samples(self) -> Rows:
        """What came since the last call: `values` (n, channels), stamped as sent, by the library's clock."""
        self.receive()
        came, self._came = self._came, []
        return Rows.joined(came)

    def events(self) -> list[str]:
        """What happened to the stream since the last call, a sentence each."""
        events, self._events = self._events, []
        return events

    def _lose(self) -> None:
        self._lost, self._inlet, self.is_open = "" if self.stream is None else self.stream.uid(), None, False

    def _take_down(self, stream: Any) -> None:
        """What a stream says of itself; refused where it came back as another one."""
        labels = StreamLabels.of(stream)
        if self.labels not in (None, labels):
            raise UnoccludeError(
                f"the stream {self.name} came back with other labels, units or channels; begin a new session"
            )
        if self.stream is not None and stream.source_id() != self.stream.source_id():
            self._events.append(f"{self.name}: found again by its name, its source_id is another")
        self.stream, self.labels = stream, labels

    def _matching(self, there: Sequence[Any]) -> Any:
        """The stream that is meant among those that are there; None where it is not."""
        if self.stream is not None:  # received before: the same source_id, or the only one of name and type
            meant = self.stream.name(), self.stream.type()
            named = [each for each in there if (each.name(), each.type()) == meant]
            same = [each for each in named if each.source_id() == self.stream.source_id()]
            return next((each[0] for each in (same, named) if _is_one(each)), None)
        part = (self._wanted or "").lower()
        exact = [each for each in there if self._wanted in (each.name(), each.source_id())]
        fitting = exact or [each for each in there if part in each.name().lower()]
        # some devices give all of their streams one name
        of_type = [each for each in fitting if each.type().lower() in self._types]
        fitting = of_type if self._wanted is None else of_type or fitting
        if not fitting or _is_one(fitting):
            return fitting[0] if fitting else None
        raise UnoccludeError(
            f"several streams are meant by {self.described}: {listed(fitting)}; give the whole name or the"
            " source_id"
        )


def _is_one(streams: Sequence[Any]) -> bool:
    """Whether it is one stream, however often it answered."""
    return len({each.uid() for each in streams}) == 1


#: Between samples of the accelerometer farther apart than this nothing is interpolated, s.
_MOST_APART_S = 0.2
#: A sample waits for the other half no longer than this, s.
_LONGEST_WAIT_S = 2.0


class ImuHalves:
    """Joins an accelerometer's samples, interpolated, to those of a gyroscope with a stream of its own."""

    def __init__(self, *names: str) -> None:
        self._steps = [StampSteps(name, STEP_OF_IMU_S) for name in names]
        self._waiting = [Rows(), Rows()]

    def joined(self, *came: Rows) -> tuple[Rows, list[str]]:
        """What both halves reach, the gyroscope's channels last; and what was done to stamps."""
        events: list[str] = []
        for at, batch in enumerate(came):
            rows, said = self._steps[at].corrected(batch)
            rows = Rows.joined([self._waiting[at], rows])
            self._waiting[at] = rows.select(np.unique(rows.t_s, return_index=True)[1])  # in order
            events += said
        acc, gyro = self._waiting
        stop = int(np.searchsorted(gyro.t_s, acc.t_s.max(initial=-np.inf), "right"))
        due, later = gyro.select(slice(0, stop)), gyro.select(slice(stop, None))
        self._waiting = [
            rows.select(rows.t_s > rows.t_s.max(initial=-np.inf) - _LONGEST_WAIT_S) for rows in (acc, later)
        ]
        after = np.searchsorted(acc.t_s, due.t_s)
        before = np.searchsorted(acc.t_s, due.t_s, "right") - 1
        held = np.flatnonzero((before >= 0) & (acc.t_s[after] - acc.t_s[before] <= _MOST_APART_S))
        if not len(held):
            return Rows(), events
        due = due.select(held)
        force = [np.interp(due.t_s, acc.t_s, channel) for channel in acc["values"].T]
        # a sample is complete when the later half has come
        arrival_s = np.maximum(due.arrival_s, acc.arrival_s[after[held]])
        return Rows(due.t_s, arrival_s, {"values": np.column_stack([*force, due["values"]])}), events


#: Content types by which streams are found that were not named.
_IMU_TYPES, _SKELETON_TYPES = ("imu", "accelerometer", "acc"), ("mocap", "skeleton")
_GYRO_TYPES = ("gyroscope", "gyro", "gyr")


@dataclass
class _Imu:
    """The streams of an IMU: one, or two with a gyroscope's of its own."""

    segment: str
    inlet: LslInlet
    gyro: LslInlet | None = None
    halves: ImuHalves | None = None
    channels: ImuChannels | None = None  # Once the streams are there

    def take(
        self, say: Callable[[str], None], there: Sequence[Any], found_gyro: Callable[..., LslInlet]
    ) -> None:
        """Take down what it sends, unless its gyroscope has a stream that is still to come."""
        labels = self.inlet.labels
        if self.channels is not None or labels is None:
            return
        name = self.inlet.name
        where = "" if self.segment == FOREARM.name else f" of the {SEGMENTS[self.segment].label}"
        if self.gyro is None and is_accelerometer(labels):
            beside = [each for each in there if each.uid() != self.inlet.stream.uid()]
            found = [each for each in beside if belongs(each.name(), each.type(), labels.name)]
            if len(found) == 1:
                self.gyro = found_gyro("--gyro ", found[0].name(), found[0].type().lower())
        if self.gyro is None:
            self.channels = ImuChannels.of(labels)
            say(f"IMU stream {name}{where} is there")
        elif self.gyro.labels is not None:
            turns = ImuChannels.of(self.gyro.labels, "gyro")
            self.channels = ImuChannels.of(labels, "acc").with_gyroscope(turns, len(labels.labels))
            self.halves = ImuHalves(name, self.gyro.name)
            say(f"accelerometer stream {name} and gyroscope stream {self.gyro.name}{where} are there")

    def rows(self) -> tuple[Rows, list[str]]:
        """What came since the last call, and what was done to its stamps."""
        came, said = self.inlet.samples(), list[str]()
        if self.halves is not None and self.gyro is not None:
            came, said = self.halves.joined(came, self.gyro.samples())
        assert self.channels is not None
        return replace(came, columns=self.channels.values(came["values"])) if len(came) else came, said


@dataclass
class _Arm:
    """The streams of one arm; the skeleton's is of all arms."""

    side: str | None
    imus: list[_Imu]  # The forearm's first
    skeleton: SkeletonChannels | None = None  # Once its stream is there


class LslSource:
    """Streams of the lab's network as one source; times count from the session's beginning."""

    speed = 1.0
    ended = False  # streams that are lost may come back

    def __init__(
        self,
        arms: Mapping[str | None, Mapping[str, str]],  # Streams of IMUs by side and segment, as far as named
        skeleton: str | None = None,
        prefer_side: str | None = None,
        body: str | None = None,
        gyro: str | None = None,  # Stream of the first arm's gyroscope where it has one of its own
        where: str = "the network",  # What can be found, in words
    ) -> None:
        lsl = lsl_module()
        self._resolver, self._since_s = lsl.ContinuousResolver(), time.monotonic()
        self._start_s = float(np.floor(lsl.local_clock()))
        self._origin_ns = time.time_ns() - int((lsl.local_clock() - self._start_s) * 1e9)
        self._inlets: list[LslInlet] = []
        self._skeleton = self._inlet("--skeleton ", skeleton, *_SKELETON_TYPES)
        self._arms = [_Arm(side, []) for side in arms]
        for arm in self._arms:
            for segment, wanted in {FOREARM.name: None, **arms[arm.side]}.items():
                place = "" if segment == FOREARM.name else f"{segment.replace('_', '-')}="
                arm.imus.append(_Imu(segment, self._inlet(f"--imu {place}", wanted, *_IMU_TYPES)))
        if gyro is not None:
            self._arms[0].imus[0].gyro = self._inlet("--gyro ", gyro, *_GYRO_TYPES)
        self._prefer_side, self._body, self._where = prefer_side, body, where
        self.infos: list[SourceInfo] = []

    def _inlet(self, option: str, wanted: str | None, *types: str) -> LslInlet:
        self._inlets.append(LslInlet(option, wanted, types, self._start_s))
        return self._inlets[-1]

    def open(
        self,
        seconds: float,
        stopped: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda _: None,
    ) -> bool:
        """Wait until all streams are there; what the first one sends meanwhile is not lost."""
        until = time.monotonic() + seconds
        while not self._all_there(say):
            if stopped():
                return False
            if time.monotonic() > until:
                names = [inlet.described for inlet in self._inlets if not inlet.is_open]
                raise UnoccludeError(
                    f"no stream for {' and '.join(names)} arrived within {seconds:g} s; streams on"
                    f" {self._where}: {listed(self._resolver.results())}"
                )
            self.wait(0.1)
        self.infos = [self._described(arm) for arm in self._arms]
        return True

    def _connect(self) -> list[Any]:
        """Connect the inlets that have no stream; the streams that are there."""
        there = self._resolver.results()
        for inlet in self._inlets:
            # until all have answered, part of a name may mean another stream
            if not inlet.is_open and time.monotonic() - self._since_s > _LISTED_S:
                inlet.connect(there)
        return there

    def _all_there(self, say: Callable[[str], None]) -> bool:
        """Take down the streams that have come; whether none is missing."""
        there, labels = self._connect(), self._skeleton.labels
        for arm in self._arms:
            for imu in arm.imus:
                imu.take(say, there, self._inlet)
            if arm.skeleton is None and labels is not None:
                forearm = arm.imus[0].inlet.labels
                side = arm.side or named_side("" if forearm is None else forearm.name)
                arm.skeleton = SkeletonChannels.of(labels, side or None, self._prefer_side, self._body)
                if arm is self._arms[0]:
                    say(f"skeleton stream {self._skeleton.name} is there")
        are_known = all(imu.channels is not None for arm in self._arms for imu in arm.imus)
        return are_known and all(inlet.is_open for inlet in self._inlets)

    def now_s(self) -> float:
        """The LSL clock of this computer, after the session's beginning."""
        return float(lsl_module().local_clock()) - self._start_s

    def wait(self, seconds: float) -> None:
        """Until something comes, at most this long."""
        until = time.monotonic() + seconds
        while not any(inlet.receive() for inlet in self._inlets) and time.monotonic() < until:
            time.sleep(_LOOK_S)

    def arrivals(self) -> list[Arrivals]:
        """What came since the last call; what happened to a stream is said with the first arm."""
        if not all(inlet.is_open for inlet in self._inlets):
            self._connect()
        came, events = list[Arrivals](), [text for inlet in self._inlets for text in inlet.events()]
        seen = self._skeleton.samples()
        for arm in self._arms:
            imus = {}
            for imu in arm.imus:
                imus[imu.segment], said = imu.rows()
                events += said
            assert arm.skeleton is not None  # since `open`
            frames = replace(seen, columns=arm.skeleton.values(seen["values"])) if len(seen) else seen
            came.append(Arrivals(imus, frames, tuple(events)))
            events = []
        return came

    def _described(self, arm: _Arm) -> SourceInfo:
        assert arm.skeleton is not None
        gyros = [(imu.inlet, imu.gyro) for imu in arm.imus if imu.gyro is not None]
        inlets = [*(imu.inlet for imu in arm.imus), self._skeleton, *(gyro for _, gyro in gyros)]
        corrections = [f"{each.name} {1e3 * each.correction_s:+.1f} ms" for each in inlets]
        notes = [f"LSL's time correction: {', '.join(corrections)}."]
        notes += [
            f"Accelerometer {acc.name} and gyroscope {gyro.name} are two streams: the accelerometer is"
            " interpolated to the gyroscope's stamps."
            for acc, gyro in gyros
        ]
        return SourceInfo(
            {imu.segment: imu.inlet.name for imu in arm.imus},
            self._skeleton.name,
            arm.skeleton.side,
            arm.skeleton.joints,
            self._origin_ns,
            arm.skeleton.camera_frame,
            lsl_start_s=self._start_s,
            notes=tuple(notes),
        )
