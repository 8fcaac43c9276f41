"""`unocclude live`: the arm while it moves, and the lines that a session prints."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..errors import UnoccludeError
from ..runtime.printable import printable
from ..table import tabulated
from . import options as o
from .output import Out, print_notes, say, say_command, show
from .run import handling

if TYPE_CHECKING:
    from ..streams.arrivals import Receiver
    from ..streams.session import SessionFigures


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
    rows = [{"stream": name, **stream} for name, stream in streams.items()]
    show(tabulated("Streams", rows, "stream count=came missing late lost_times=times_lost lost_s"))
    done = figures["frame_done"]
    if done["count"]:
        say(
            f"frames done after {done['median_ms']:.1f} ms (99 % within {done['percentile_99_ms']:.1f}, all"
            f" within {done['largest_ms']:.1f}); load {100 * figures['load']:.0f} % of a core"
        )
    for event in figures["events"][-20:]:
        say(f"{event['t_s']:8.1f} s  {event['event']}")


def live(
    out: Out,
    imu: Annotated[
        o.Texts,
        o.value(
            "[PLACE=]STREAM",
            "The IMU's LSL stream; a topic with --replay. Of several each with its place: upper-arm, hand;"
            " with --arms both right, left, right-upper-arm, ..",
        ),
    ] = None,
    gyro: Annotated[
        o.Text, o.value("STREAM", "The gyroscope's LSL stream, if it has one of its own.")
    ] = None,
    skeleton: Annotated[
        o.Text, o.value("STREAM", "The skeleton's LSL stream; a topic with --replay.")
    ] = None,
    side: o.Side = None,
    arms: Annotated[Literal["one", "both"], o.option("Both arms of a person, each with its IMU.")] = "one",
    body: Annotated[o.Text, o.value("N", "Which of the skeleton's bodies.")] = None,
    calibration: o.Calibration = None,
    lag: Annotated[float, o.value("S", "Delay of the settled result.", min=0, max=2)] = 0.2,
    record: Annotated[
        o.File, o.value("OUT.mcap", "Record everything that arrives.", callback=o.as_mcap), o.WRITTEN
    ] = None,
    replay: Annotated[o.File, o.value("REC.mcap", "Replay a recording in real time.")] = None,
    speed: Annotated[float, o.value("X", "Of the replay; 0 = as fast as possible.", min=0)] = 1.0,
    view: Annotated[bool, o.option("Show it in Rerun; needs `pip install '.[view]'`.", "--view")] = False,
    config_file: o.ConfigFile = None,
    latency: Annotated[
        o.Number, o.rare_value("S", "Of a replay's camera.  [default: 0.1 s]", min=0, max=2)
    ] = None,
    lsl_out: Annotated[
        o.Text, o.rare_value("NAME", "Send the arm as LSL streams NAME and NAME_settled.")
    ] = None,
    lsl_network: Annotated[
        bool, o.rare("With --lsl-out: send to, and find streams on, the whole network.", "--lsl-network")
    ] = False,
    wait: Annotated[float, o.rare_value("S", "How long to wait for the streams.", min=0)] = 30.0,
) -> None:
    """Recover the arm live: now, and a moment ago with less error.

    Streams come from the Lab Streaming Layer, with labelled channels and units. Ctrl-C ends the session with
    a complete recording. Needs `pip install '.[live]'`.

    Example: unocclude live --imu wrist --skeleton kinect --side right --record session.mcap --view
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

    from ..body import SEGMENTS
    from ..live.calibrations import InlineCalibrator
    from ..live.smoother import LiveSmoother
    from ..streams.lsl import LslSender, LslSource, lsl_module, stay_here
    from ..streams.replay import CAMERA_LATENCY_S, Replay
    from ..streams.session import LiveSession, SessionCalibration
    from ..streams.session_recording import SessionRecording, check_recording
    from ..streams.viewer import RerunView, rerun_module
    from .config import read_config
    from .export import live_window

    if record is not None:
        check_recording(record, out.force)
    where = "the network"
    if replay is None or lsl_out is not None:
        lsl_module()
    if lsl_out is not None and not lsl_network:
        stay_here()
        where = "this computer (--lsl-network: on the network)"
    if view:
        rerun_module()
    config = read_config(config_file)
    file = None if calibration is None else read_calibration(calibration)
    known_sides = [] if file is None else [name for name in file.arms if name != "any"]
    prefer = known_sides[0] if len(known_sides) == 1 else None
    wanted: list[int] = []  # signals to end, which interrupt nothing, so that the recording stays whole
    with handling(lambda number, _: wanted.append(number)), ExitStack() as stack:
        source: LslSource | Replay
        if replay is not None:
            topics = {each: own.get("forearm") for each, own in imus.items()}
            latency_s = CAMERA_LATENCY_S if latency is None else latency
            source = Replay(replay, topics, skeleton, prefer, speed, latency_s)
            names = [name for info in source.infos for name in info.imus.values()]
            if len(set(names)) < len(names):
                raise UnoccludeError(
                    f"{replay}: which IMU is on which arm does not show by the topics' names; give --imu"
                    " right=TOPIC --imu left=TOPIC"
                )
        else:
            source = LslSource(imus, skeleton, prefer, body, gyro, where)
            say(f"looking for the streams, at most {wait:g} s")
            if not source.open(wait, lambda: bool(wanted), say):
                say("ended before the streams were there; nothing was recorded")
                return
        infos = source.infos
        calibrations = [SessionCalibration.of(file, info) for info in infos]
        for info, known in zip(infos, calibrations, strict=True):
            arm, (forearm, *others) = f"{info.side} arm".strip(), info.imus.items()
            say(f"IMU {forearm[1]}, {arm} of {info.skeleton} ({', '.join(info.joints)})")
            for segment, name in others:
                say(f"IMU {name} on the {SEGMENTS[segment].label}")
            print_notes([*info.notes, *known.notes])
        receivers: list[Receiver] = []
        if view:
            receivers.append(viewer := RerunView(infos, stack.enter_context(live_window())))
            stack.callback(viewer.close)
            say("the window of Rerun opens; it closes when the session ends")
        if lsl_out is not None:
            names = [f"{lsl_out}_{each.side}" if len(infos) > 1 else lsl_out for each in infos]
            receivers.append(sender := LslSender(names, infos))
            stack.callback(sender.close)
            for name in names:
                who = "all computers of this network" if lsl_network else "this computer"
                say(f"LSL: streams {name} and {name}_settled, for {who}")
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
            session.run(lambda: bool(wanted), lines.show)
        figures = [{"side": each.side, **each.figures()} for each in session.figures]
    out.json({**figures[0], "arms": figures} if len(figures) > 1 else session.figures[0].figures())
    for own in figures:
        print_session(own, f"{own['side']} arm, " if len(sides) > 1 else "")
    is_recorded = recording is not None and recording.is_whole
    out.end(record if is_recorded else None)
    if record is not None and is_recorded:
        arguments = ["smooth", str(record), "-o", str(record.with_name(f"{record.stem}_recovered.mcap"))]
        for option, value in (("--calibration", calibration), ("--config", config_file)):
            arguments += [] if value is None else [option, str(value)]
        say_command(*arguments)


#: How often a line is printed, s; how long a terminal is waited for in the end, s, and how many lines are.
_LINE_S, _PATIENCE_S, _MOST_WAITING = 2.0, 2.0, 1000


class Lines:
    """A line every two seconds for each arm, and one for whatever happens."""

    def __init__(self) -> None:
        from ..streams.session_recording import Outbox

        self._last_s, self._events = -math.inf, dict[str, int]()
        self._lines: Outbox[str] = Outbox(_print, _MOST_WAITING, "lines")

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        self._lines.drain(_PATIENCE_S)

    def show(self, *arms: SessionFigures) -> None:
        """Print what happened to each arm since, and the line if it is time."""
        is_time = time.monotonic() - self._last_s > _LINE_S
        for figures in arms:
            arm = f"{figures.side} arm: " if len(arms) > 1 else ""
            new = figures.event_count - self._events.get(figures.side, 0)
            self._events[figures.side] = figures.event_count
            for when, sentence in list(figures.events)[-new:] if new else ():
                self._lines.put(f"{when:8.1f} s  {arm}{sentence}")
            if is_time:
                self._last_s = time.monotonic()
                self._lines.put(f"{figures.seconds:8.1f} s  {arm}{'; '.join(words(figures))}")


def _print(line: str) -> None:
    say(line)
    sys.stdout.flush()


def words(figures: SessionFigures) -> list[str]:
    """The session in words: the answer, the streams, the clock, the load."""
    output, camera, (imu, *further) = figures.output, figures.skeleton, figures.imus.values()
    # the camera's delay is from a frame's moment, as soon as its clock is known
    latency_s = math.nan if output is None else output.camera_latency_s
    streams = [("IMU", imu, imu.delay_s)]
    streams.append(("camera", camera, latency_s if math.isfinite(latency_s) else camera.delay_s))
    streams += [(each.name, each, each.delay_s) for each in further]
    said = [_answer_words(figures)]
    for name, stream, delay_s in streams:
        delay = f"{1e3 * delay_s:.0f} ms" if math.isfinite(delay_s) else "-"
        missing = f", {stream.missing} missing" if stream.missing else ""
        rate = f"{name} {stream.rate_hz(figures.now_s):.1f} /s, delay {delay}{missing}"
        said.append(f"{name}: nothing comes" if stream.is_lost else rate)
    if output is not None and output.now is not None:
        said.append(f"sigma {100 * output.now.sigma_m:.1f} cm, {output.now.sigma_deg:.1f} degrees")
    if output is not None and math.isfinite(output.clock_offset_s):
        offset_ms, sigma_ms = 1e3 * output.clock_offset_s, 1e3 * output.clock_sigma_s
        said.append(f"clock offset {offset_ms:+.1f} +- {sigma_ms:.1f} ms")
    if output is not None and (dropped := sum(output.dropped.values())):
        said.append(f"{dropped} dropped")
    if output is not None and math.isfinite(output.step_ms):
        said.append(f"step {output.step_ms:.1f} ms")
    return [*said, f"load {100 * figures.load:.0f} %"]


def _answer_words(figures: SessionFigures) -> str:
    output = figures.output
    if output is None:
        return "nothing has come yet"
    if output.state == "calibrating" and output.calibration:
        return f"calibrating ({printable(output.calibration)})"
    if output.state == "lost":
        is_lost = figures.imu.is_lost or figures.skeleton.is_lost
        return "a stream is lost: no answer" if is_lost else "no answer: catching up with the streams"
    if output.state == "gap" and output.now is not None and output.now.since_s is not None:
        return f"gap since {output.now_s - output.now.since_s:.1f} s"
    return str(output.state)
