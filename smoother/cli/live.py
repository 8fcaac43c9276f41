"""`unocclude live`: the arm while it moves, and the lines that a session prints."""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from queue import Full, Queue
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..errors import UnoccludeError
from ..runtime.printable import printable
from ..table import Table
from . import options as o
from .output import Out, print_notes, say, say_command, show

if TYPE_CHECKING:
    from ..live.answers import LiveOutput
    from ..streams.arrivals import Receiver, Source, SourceInfo
    from ..streams.session import SessionCalibration
    from ..streams.session_figures import SessionFigures, StreamHealth


@contextmanager
def stop_request() -> Iterator[Callable[[], bool]]:
    """Whether a session is to end: a signal interrupts nothing, so that the recording stays whole."""
    wanted: list[int] = []
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, lambda number, _: wanted.append(number))
    try:
        yield lambda: bool(wanted)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
    streams = {"IMU": figures["imu"], "camera": figures["skeleton"]}
    streams |= {f"IMU on the {SEGMENTS[name].label}": one for name, one in figures.get("further", {}).items()}
    keys = ("count", "missing", "late", "lost_times", "lost_s")
    rows = [(name, *(stream[key] for key in keys)) for name, stream in streams.items()]
    show(Table("Streams", ("stream", "came", "missing", "late", "times lost", "lost, s"), rows))
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
    side: o.Side = None,
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
    further = any(set(streams) - {"forearm"} for streams in imus.values())
    o.refuse(
        {
            "--speed is of a replay; give --replay as well": replay is None and speed != 1.0,
            "--latency is of a replay; give --replay as well": replay is None and latency is not None,
            "--gyro is of one arm; with --arms both it is found by the --imu's name": gyro and arms == "both",
            "--body is of a stream; a replay takes --imu and --skeleton": body and replay,
            "--gyro is of a stream; a replay takes --imu and --skeleton": gyro and replay,
            "a further --imu is of a stream; a replay takes --imu and --skeleton": further and replay,
            "--lsl-network is of what --lsl-out sends; give it as well": lsl_network and lsl_out is None,
        }
    )
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
    with stop_request() as stops, ExitStack() as stack:
        source: Source
        if replay is not None:
            topics = {each: own.get("forearm") for each, own in imus.items()}
            source = Replay(
                replay, topics, skeleton, prefer, speed, CAMERA_LATENCY_S if latency is None else latency
            )
            names = [name for info in source.infos for name in info.imus.values()]
            if len(set(names)) < len(names):
                raise UnoccludeError(
                    f"{replay}: which IMU is on which arm does not show by the topics' names; give --imu"
                    " right=TOPIC --imu left=TOPIC"
                )
        else:
            source = received = LslSource(imus, skeleton, prefer, body, gyro)
            stack.callback(received.close)
            say(f"looking for the streams, at most {wait:g} s")
            if not received.open(wait, stops, say):
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
            session.run(stops, lines.show)
        figures = [each.figures() for each in session.figures]
    arm_figures = [{"side": info.side, **own} for info, own in zip(infos, figures, strict=True)]
    several = {**arm_figures[0], "arms": arm_figures}
    out.json(several if len(figures) > 1 else figures[0])
    for own in arm_figures:
        print_session(own, f"{own['side']} arm, " if len(sides) > 1 else "")
    has_recording = recording is not None and recording.has_samples
    out.end(record if has_recording else None)
    if record is not None and has_recording:
        arguments = ["smooth", str(record), "-o", str(record.with_name(f"{record.stem}_recovered.mcap"))]
        for option, value in (("--calibration", calibration), ("--config", config_file)):
            arguments += [] if value is None else [option, str(value)]
        say_command(*arguments)


#: How often a line is printed, s.
_LINE_S = 2.0
#: How long a terminal is waited for in the end, s, and how many lines wait for it at most.
_PATIENCE_S, _MOST_WAITING = 2.0, 1000


class Lines:
    """A line every two seconds for each arm, and one for whatever happens.

    They are printed by a thread of its own: a slow terminal delays no answer.
    """

    def __init__(self) -> None:
        self._last = -math.inf
        self._events: dict[str, int] = {}
        self._waiting: Queue[str | None] = Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._work, name="lines", daemon=True)

    def __enter__(self) -> Lines:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._put(None)
        self._thread.join(_PATIENCE_S)

    def show(self, *arms: SessionFigures) -> None:
        """Print what happened to each arm since, and the line if it is time."""
        is_time = time.monotonic() - self._last > _LINE_S
        for figures in arms:
            arm = f"{figures.side} arm: " if len(arms) > 1 else ""
            new = figures.event_count - self._events.get(figures.side, 0)
            for when, sentence in list(figures.events)[-new:] if new else ():
                self._put(f"{when:8.1f} s  {arm}{sentence}")
            self._events[figures.side] = figures.event_count
            if is_time:
                self._last = time.monotonic()
                self._put(f"{figures.seconds:8.1f} s  {arm}{'; '.join(words(figures))}")

    def _put(self, line: str | None) -> None:
        with suppress(Full):
            self._waiting.put_nowait(line)

    def _work(self) -> None:
        while (line := self._waiting.get()) is not None:
            say(line)
            sys.stdout.flush()


def words(figures: SessionFigures) -> list[str]:
    """The session in words: the answer, the streams, the clock, the load."""
    output, camera = figures.output, figures.skeleton
    imu, *further = figures.imus.values()
    # the camera's delay is from a frame's moment, as soon as its clock is known
    is_known = output is not None and math.isfinite(output.camera_latency_s)
    latency_s = output.camera_latency_s if output is not None and is_known else camera.delay_s
    streams = [
        _stream_words("IMU", imu, imu.delay_s, figures.now_s),
        _stream_words("camera", camera, latency_s, figures.now_s),
        *(_stream_words(each.name, each, each.delay_s, figures.now_s) for each in further),
    ]
    load = f"load {100 * figures.load:.0f} %"
    if output is None:
        return ["nothing has come yet", *streams, load]
    rest = []
    if output.now is not None:
        rest.append(f"sigma {100 * output.now.sigma_m:.1f} cm, {output.now.sigma_deg:.1f} degrees")
    if math.isfinite(output.clock_offset_s):
        offset = f"clock offset {1e3 * output.clock_offset_s:+.1f}"
        rest.append(f"{offset} +- {1e3 * output.clock_sigma_s:.1f} ms")
    if dropped := sum(output.dropped.values()):
        rest.append(f"{dropped} dropped")
    if math.isfinite(output.step_ms):
        rest.append(f"step {output.step_ms:.1f} ms")
    return [_state_words(figures, output), *streams, *rest, load]


def _state_words(figures: SessionFigures, output: LiveOutput) -> str:
    state = str(output.state)
    if state == "calibrating":
        return f"calibrating ({printable(output.calibration)})" if output.calibration else "calibrating"
    if state == "lost":
        is_lost = figures.imu.is_lost or figures.skeleton.is_lost
        return "a stream is lost: no answer" if is_lost else "no answer: catching up with the streams"
    if state == "gap" and output.now is not None and output.now.since_s is not None:
        return f"gap since {output.now_s - output.now.since_s:.1f} s"
    return state


def _stream_words(name: str, stream: StreamHealth, delay_s: float, now_s: float) -> str:
    if stream.is_lost:
        return f"{name}: nothing comes"
    delay = f"{1e3 * delay_s:.0f} ms" if math.isfinite(delay_s) else "-"
    missing = f", {stream.missing} missing" if stream.missing else ""
    return f"{name} {stream.rate_hz(now_s):.1f} /s, delay {delay}{missing}"
