"""`unocclude live`: the arm while it moves."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..errors import UnoccludeError
from . import options as o
from .live_lines import Lines
from .output import Out, print_notes, say, say_command

if TYPE_CHECKING:
    from ..streams.arrivals import Receiver, Source, SourceInfo
    from ..streams.session import SessionCalibration


class StopRequest:
    """Takes signals down; nothing is interrupted, so that the recording stays whole."""

    def __init__(self) -> None:
        self.wanted = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._end)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def __call__(self) -> bool:
        """Whether the session is to end."""
        return self.wanted

    def _end(self, number: int, _: FrameType | None) -> None:
        self.wanted = True


def streams_of(given: Sequence[str], sides: Sequence[str | None]) -> dict[str | None, dict[str, str]]:
    """Names of streams or topics by arm and segment, of `--imu [PLACE=]STREAM`."""
    from ..body import FOREARM, FURTHER

    places = {}
    for side in sides:
        for worn_on in (FOREARM, *FURTHER):
            own = "" if worn_on is FOREARM else worn_on.name.replace("_", "-")
            place = "-".join(filter(None, (side if len(sides) > 1 else None, own)))
            places[place] = side, worn_on.name
    streams: dict[str | None, dict[str, str]] = {side: {} for side in sides}
    for text in given:
        key, mark, name = text.partition("=")
        if len(sides) == 1 and not mark:
            key, name = "", text
        side, segment = places.get(key, (None, ""))
        if not segment or not name or segment in streams[side]:
            known = ", ".join(filter(None, places))
            raise typer.BadParameter(f"--imu {text}: give PLACE=STREAM once for each place, of {known}")
        streams[side][segment] = name
    return streams


def check_arms(infos: Sequence[SourceInfo], replay: Path) -> None:
    """Refuse two arms of which one topic is to be both."""
    names = [name for info in infos for name in info.imus.values()]
    if len(set(names)) < len(names):
        raise UnoccludeError(
            f"{replay}: which IMU is on which arm does not show by the topics' names; give --imu right=TOPIC"
            " --imu left=TOPIC"
        )


def receivers_of(
    infos: Sequence[SourceInfo], foxglove: int | None, lsl_out: str | None, lsl_network: bool
) -> Iterator[Receiver]:
    """Who is sent the answers, and where they are found."""
    if foxglove is not None:
        from ..streams.foxglove import FoxgloveServer

        server = FoxgloveServer(infos, foxglove)
        say(f"Foxglove: open connection, Foxglove WebSocket, {server.address}; layout:"
            " docs/unocclude.foxglove-layout.json")  # fmt: skip
        yield server
    if lsl_out is not None:
        from ..streams.lsl import LslSender

        names = [f"{lsl_out}_{each.side}" if len(infos) > 1 else lsl_out for each in infos]
        sender = LslSender(names, infos, lsl_network)
        who = "all computers of this network" if lsl_network else "this computer"
        for name in names:
            say(f"LSL: streams {name} and {name}_settled, for {who}")
        yield sender


def print_source(info: SourceInfo, calibration: SessionCalibration) -> None:
    """Say what is used."""
    from ..body import SEGMENTS

    arm = f"{info.side} arm" if info.side else "arm"
    forearm, *further = info.imus.items()
    say(f"IMU {forearm[1]}, {arm} of {info.skeleton} ({', '.join(info.joints)})")
    for segment, name in further:
        say(f"IMU {name} on the {SEGMENTS[segment].label}")
    print_notes([*info.notes, *calibration.notes])


def print_session(figures: dict[str, Any], arm: str = "") -> None:
    """Print what the session was like, of an arm."""
    from ..body import SEGMENTS

    state = figures["state_s"]
    say(
        f"{arm}{figures['seconds']:.1f} s: visible {state['visible']:.1f} s, {figures['gaps']} gaps of"
        f" {state['gap']:.1f} s, the longest {figures['longest_gap_s']:.1f} s; calibrating"
        f" {state['calibrating']:.1f} s, the IMU lost {state['lost']:.1f} s"
    )
    streams = [("IMU", figures["imu"]), ("camera", figures["skeleton"])]
    for segment, stream in figures.get("further", {}).items():
        streams.append((f"IMU on the {SEGMENTS[segment].label}", stream))
    for name, stream in streams:
        words = f"{stream['count']} came, {stream['missing']} missing, {stream['late']} late"
        if stream["lost_times"]:
            words += f", lost {stream['lost_times']} times for {stream['lost_s']:.1f} s"
        say(f"{name}: {words}")
    done = figures["frame_done"]
    if done["count"]:
        say(
            f"frames done after {done['median_ms']:.1f} ms (99 % within {done['percentile_99_ms']:.1f}, all"
            f" within {done['largest_ms']:.1f}); load {100 * figures['load']:.0f} % of a core"
        )
    for event in figures["events"][-20:]:
        say(f"{event['t_s']:8.1f} s  {event['event']}")


#: `--foxglove` alone: the usual port.
ALONE = {"--foxglove": "8765"}


def live(
    out: Out,
    imu: Annotated[
        list[str] | None,
        o.option(
            "The IMU's LSL stream; a topic with --replay. Of several each with its place: upper-arm, hand;"
            " with --arms both right, left, right-upper-arm, ..",
            metavar="[PLACE=]STREAM",
        ),
    ] = None,
    gyro: Annotated[
        str | None, o.option("The gyroscope's LSL stream, if it has one of its own.", metavar="STREAM")
    ] = None,
    skeleton: Annotated[
        str | None, o.option("The skeleton's LSL stream; a topic with --replay.", metavar="STREAM")
    ] = None,
    side: Annotated[Literal["left", "right"] | None, o.option("The arm that wears the IMU.")] = None,
    arms: Annotated[Literal["one", "both"], o.option("Both arms of a person, each with its IMU.")] = "one",
    body: Annotated[str | None, o.option("Which of the skeleton's bodies.", metavar="N")] = None,
    calibration: o.Calibration = None,
    lag: Annotated[float, o.option("Delay of the settled result.", metavar="S", min=0, max=2)] = 0.2,
    record: Annotated[
        o.File, o.value("OUT.mcap", "Record everything that arrives.", callback=o.as_mcap), o.WRITTEN
    ] = None,
    replay: Annotated[Path | None, o.option("Replay a recording in real time.", metavar="REC.mcap")] = None,
    speed: Annotated[float, o.option("Of the replay; 0 = as fast as possible.", metavar="X", min=0)] = 1.0,
    foxglove: Annotated[
        int | None,
        o.option("Show it in Foxglove, on port 8765 (0: a free one).", metavar="[PORT]", min=0, max=65535),
    ] = None,
    config_file: o.ConfigFile = None,
    latency: Annotated[
        float | None, o.rare("Of a replay's camera.  [default: 0.1 s]", metavar="S", min=0, max=2)
    ] = None,
    lsl_out: Annotated[
        str | None, o.rare("Send the arm as LSL streams NAME and NAME_settled.", metavar="NAME")
    ] = None,
    lsl_network: Annotated[
        bool, o.rare("Announce them to the whole network, not only here.", "--lsl-network")
    ] = False,
    wait: Annotated[float, o.rare("How long to wait for the streams.", metavar="S", min=0)] = 30.0,
) -> None:
    """Recover the arm live: now, and a moment ago with less error.

    Streams come from the Lab Streaming Layer, with labelled channels and units. Ctrl-C ends the session with
    a complete recording. Needs `pip install '.[live]'`.

    Example: unocclude live --imu wrist --skeleton kinect --side right --record session.mcap --foxglove
    """
    both: list[str | None] = ["left", "right"] if side == "left" else ["right", "left"]
    sides = [side] if arms == "one" else both
    imus = streams_of(imu or (), sides)
    if lsl_network and lsl_out is None:
        raise typer.BadParameter("--lsl-network is of what --lsl-out sends; give it as well")
    for option, given in (("--speed", speed != 1.0), ("--latency", latency is not None)):
        if given and replay is None:
            raise typer.BadParameter(f"{option} is of a replay; give --replay as well")
    further = any(set(streams) - {"forearm"} for streams in imus.values())
    if arms == "both" and gyro is not None:
        raise typer.BadParameter("--gyro is of one arm; with --arms both it is found by the --imu's name")
    for option, named in (("--body", body), ("--gyro", gyro), ("a further --imu", further)):
        if named and replay is not None:
            raise typer.BadParameter(f"{option} is of a stream; a replay takes --imu and --skeleton")
    from calib.file import read_calibration

    from ..live.calibrations import InlineCalibrator
    from ..live.smoother import LiveSmoother
    from ..streams.foxglove import foxglove_module
    from ..streams.lsl import lsl_module
    from ..streams.lsl_source import LslSource
    from ..streams.replay import CAMERA_LATENCY_S, Replay
    from ..streams.session import LiveSession, SessionCalibration
    from ..streams.session_recording import SessionRecording, check_recording
    from .config import read_config

    if record is not None:
        check_recording(record, out.force)
    if replay is None or lsl_out is not None:
        lsl_module()
    if foxglove is not None:
        foxglove_module()
    config = read_config(config_file)
    file = None if calibration is None else read_calibration(calibration)
    known_sides = [] if file is None else [name for name in file.arms if name != "any"]
    prefer = known_sides[0] if len(known_sides) == 1 else None
    with StopRequest() as stop_request, ExitStack() as stack:
        source: Source
        if replay is not None:
            topics = {each: own.get("forearm") for each, own in imus.items()}
            source = Replay(
                replay, topics, skeleton, prefer, speed, CAMERA_LATENCY_S if latency is None else latency
            )
            check_arms(source.infos, replay)
        else:
            source = received = LslSource(imus, skeleton, prefer, body, gyro)
            stack.callback(received.close)
            say(f"looking for the streams, at most {wait:g} s")
            if not received.open(wait, stop_request, say):
                say("ended before the streams were there; nothing was recorded")
                return
        infos = source.infos
        calibrations = [SessionCalibration.of(file, info) for info in infos]
        for info, of_arm in zip(infos, calibrations, strict=True):
            print_source(info, of_arm)
        receivers = []
        for receiver in receivers_of(infos, foxglove, lsl_out, lsl_network):
            stack.callback(receiver.close)
            receivers.append(receiver)
        recording = None
        if record is not None:
            recording = SessionRecording(record, infos, out.force, patient=not source.speed)
            stack.callback(recording.close)  # whatever ends the sessions, their recording is whole
        engines = []
        for info, known in zip(infos, calibrations, strict=True):
            # as fast as possible, the background may be waited for too
            calibrator = None if source.speed else InlineCalibrator()
            about = known.arm, known.config(config), lag, info.gravity_hint, info.camera_frame, calibrator
            engines.append(stack.enter_context(LiveSmoother(info.side, *about, list(info.imus)[1:])))
        session = LiveSession(source, engines, calibrations, recording, receivers)
        if sys.stdout.isatty():
            say("Ctrl-C ends")
        with Lines() as lines:
            session.run(stop_request, lines.show)
        figures = [each.figures() for each in session.figures]
    arm_figures = [{"side": info.side, **own} for info, own in zip(infos, figures, strict=True)]
    several = {**arm_figures[0], "arms": arm_figures}
    for own in arm_figures:
        print_session(own, f"{own['side']} arm, " if len(sides) > 1 else "")
    has_recording = recording is not None and recording.has_samples
    out.end(several if len(figures) > 1 else figures[0], record if has_recording else None)
    if record is not None and has_recording:
        arguments = ["smooth", str(record), "-o", str(record.with_name(f"{record.stem}_recovered.mcap"))]
        for option, value in (("--calibration", calibration), ("--config", config_file)):
            arguments += [] if value is None else [option, str(value)]
        say_command(*arguments)
