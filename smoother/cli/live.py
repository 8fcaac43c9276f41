"""`unocclude live`: the arm while it moves."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import GroupedCommand
from .live_arms import check_arms, further_streams, receivers_of, sides_of, streams_of_arms, together
from .live_lines import Lines
from .options import Calibration, ConfigFile, Force, Json, Side, one_side
from .output import check_mcap, check_outputs, print_notes, say, say_command, say_written, write_json

if TYPE_CHECKING:
    from ..config import Config
    from ..streams.arrivals import Source
    from ..streams.lsl_source import LslSource
    from ..streams.session import LiveSession, Receiver, SessionCalibration
    from ..streams.session_recording import Recorder


_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")


class StopRequest:
    """Takes signals and keys down; nothing is interrupted, so that the recording stays whole.

    Keys on a terminal: `q` ends, `s` ends and smooths what was recorded.
    """

    def __init__(self) -> None:
        self.wanted = self.smooth = self.killed = False
        self._before: dict[int, Any] = {}
        self._terminal: list[Any] | None = None

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            for name in _SIGNALS:
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._end)
        with suppress(ImportError, OSError, ValueError, AttributeError):
            import termios
            import tty

            # in the background of a shell, a change of the terminal would stop this program
            if sys.stdin.isatty() and os.getpgrp() == os.tcgetpgrp(sys.stdin.fileno()):
                self._terminal = termios.tcgetattr(sys.stdin)
                tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._terminal is not None:
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._terminal)

    @property
    def has_keys(self) -> bool:
        """Keys are listened to."""
        return self._terminal is not None

    def __call__(self) -> bool:
        """Whether the session is to end."""
        if self._terminal is not None and not self.wanted:
            self._read_key()
        return self.wanted

    def _read_key(self) -> None:
        import select

        if select.select([sys.stdin], [], [], 0)[0]:
            key = os.read(sys.stdin.fileno(), 1).decode("ascii", "ignore").lower()
            self.wanted = key in ("q", "s")
            self.smooth = key == "s"
            if not key:  # the terminal has gone
                self._terminal = None

    def _end(self, number: int, _: FrameType | None) -> None:
        self.wanted = True
        self.killed |= number != signal.SIGINT


def lsl_source(
    imu: str | None,
    skeleton: str | None,
    side: str | None,
    prefer_side: str | None,
    body: str | None,
    gyro: str | None,
    further: dict[str, str],
    wait_s: float,
    stop_request: StopRequest,
    stack: ExitStack,
    beside: LslSource | None = None,
) -> LslSource | None:
    """Streams of the Lab Streaming Layer, once both are there; None where it was ended before."""
    from ..streams.lsl_source import LslSource

    source = LslSource(imu, skeleton, side, prefer_side, body, gyro, further, beside)
    stack.callback(source.close)
    if beside is None:
        say(f"looking for the streams, at most {wait_s:g} s")
    return source if source.open(wait_s, stop_request, say) else None


@contextmanager
def engine_sessions(
    sources: Sequence[Source],
    calibrations: Sequence[SessionCalibration],
    config: Config,
    lag_s: float,
    recording: Recorder | None,
    receivers: Sequence[Sequence[Receiver]],
) -> Iterator[list[LiveSession]]:
    """A session for each arm; whatever ends them, their recording is whole."""
    from ..live.calibrations import InlineCalibrator
    from ..live.smoother import LiveSmoother
    from ..streams.session import LiveSession

    sessions = []
    with ExitStack() as stack:
        if recording is not None:
            stack.callback(recording.close)
        arms = zip(sources, calibrations, receivers, strict=True)
        for number, (source, calibration, of_arm) in enumerate(arms):
            info = source.info
            engine = LiveSmoother(
                info.side,
                calibration.arm,
                calibration.config(config),
                lag_s,
                info.gravity_hint,
                info.camera_frame,
                None if source.speed else InlineCalibrator(),  # the background may be waited for too
                list(info.further),
            )
            stack.enter_context(engine)
            sessions.append(LiveSession(source, engine, calibration, recording, of_arm, number))
        yield sessions


def run_sessions(sessions: Sequence[LiveSession], stop_request: StopRequest) -> list[dict[str, Any]]:
    """Run the sessions of all arms until they end, and show them; their figures."""
    from ..streams.session import run_together

    if sys.stdout.isatty():
        say("q ends, s ends and smooths" if stop_request.has_keys else "Ctrl-C ends")
    with Lines() as lines:
        return [each.figures() for each in run_together(sessions, stop_request, lines.show)]


def print_source(source: Source, calibration: SessionCalibration) -> None:
    """Say what is used."""
    from ..body import SEGMENTS

    info = source.info
    arm = f"{info.side} arm" if info.side else "arm"
    say(f"IMU {info.imu}, {arm} of {info.skeleton} ({', '.join(info.joints)})")
    for segment, name in info.further.items():
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


def smooth_recording(arguments: Sequence[str]) -> None:
    """Run `unocclude smooth` on what was recorded."""
    from .app import app

    app(list(arguments), prog_name="unocclude", standalone_mode=False)


_FOXGLOVE, _PORT = "--foxglove", 8765


class LiveCommand(GroupedCommand):
    """Lets `--foxglove` stand alone: the port is then the usual one."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give one that no number follows its port."""
        complete: list[str] = []
        for place, arg in enumerate(args):
            complete.append(arg)
            follows = args[place + 1] if place + 1 < len(args) else "-"
            if arg == _FOXGLOVE and follows.startswith("-"):
                complete.append(str(_PORT))
        return list(super().parse_args(ctx, complete))


def live(
    imu: Annotated[
        list[str] | None,
        typer.Option(
            "--imu",
            metavar="STREAM",
            help="Name of the IMU's LSL stream; a topic with --replay. With --arms both right=STREAM and"
            " left=STREAM.",
        ),
    ] = None,
    skeleton: Annotated[
        str | None,
        typer.Option(
            "--skeleton", metavar="STREAM", help="Name of the skeleton's LSL stream; a topic with --replay."
        ),
    ] = None,
    gyro: Annotated[
        str | None,
        typer.Option(
            "--gyro", metavar="STREAM", help="Name of the gyroscope's LSL stream, if it has one of its own."
        ),
    ] = None,
    further_imu: Annotated[
        list[str] | None,
        typer.Option(
            "--further-imu",
            metavar="SEGMENT=STREAM",
            help="LSL stream of a further IMU of the arm: upper-arm=NAME; may be given again.",
        ),
    ] = None,
    side: Side = None,
    arms: Annotated[
        str, typer.Option("--arms", metavar="one|both", help="Both arms of one person, each with its IMU.")
    ] = "one",
    body: Annotated[
        str | None,
        typer.Option("--body", metavar="N", help="Which of several bodies of the skeleton's LSL stream."),
    ] = None,
    calibration_file: Calibration = None,
    config_file: ConfigFile = None,
    lag_s: Annotated[
        float,
        typer.Option("--lag", metavar="S", min=0.0, max=2.0, help="Delay of the settled result."),
    ] = 0.2,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="OUT.mcap", help="Record everything that arrives.")
    ] = None,
    then_smooth: Annotated[
        bool,
        typer.Option("--then-smooth", help="Smooth the recording afterwards, as `unocclude smooth` does."),
    ] = False,
    replay: Annotated[
        Path | None,
        typer.Option("--replay", metavar="REC.mcap", help="Replay a recording in real time."),
    ] = None,
    speed: Annotated[
        float,
        typer.Option("--speed", metavar="X", min=0.0, help="Speed of the replay; 0 = as fast as possible."),
    ] = 1.0,
    latency_s: Annotated[
        float | None,
        typer.Option(
            "--latency",
            metavar="S",
            min=0.0,
            max=2.0,
            help="Latency of the camera in a replay.  [default: the recording's, else 0.1 s]",
        ),
    ] = None,
    foxglove: Annotated[
        int | None,
        typer.Option(
            _FOXGLOVE,
            metavar="[PORT]",
            min=0,
            max=65535,
            help=f"Show it in Foxglove, on local port {_PORT} (0: a free one).",
        ),
    ] = None,
    lsl_out: Annotated[
        str | None,
        typer.Option("--lsl-out", metavar="NAME", help="Send the arm as LSL streams NAME and NAME_settled."),
    ] = None,
    lsl_network: Annotated[
        bool,
        typer.Option("--lsl-network", help="Announce them to the whole network, not only to this computer."),
    ] = False,
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0.0, help="How long to wait for the streams.")
    ] = 30.0,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Recover the arm live: now, and a moment ago with less error.

    Streams come from the Lab Streaming Layer, with labelled channels and units. Ctrl-C (or q) ends the
    session with a complete recording; s ends it and smooths the recording. Needs
    `pip install '.[live]'`.
    """
    side = one_side(side)
    sides = sides_of(arms, side, gyro)
    imus, further = streams_of_arms(imu or (), sides), further_streams(further_imu or (), sides)
    of_streams = {"--body": body, "--gyro": gyro, "--further-imu": "".join(further_imu or ()) or None}
    if lsl_network and lsl_out is None:
        raise typer.BadParameter("--lsl-network is of what --lsl-out sends; give it as well")
    _check_use(
        record, then_smooth, replay, of_streams, {"--speed": speed != 1.0, "--latency": latency_s is not None}
    )
    recovered = recovered_name(record) if record is not None and then_smooth else None
    check_outputs(force, [record, recovered, json_file], [calibration_file, config_file, replay])
    from ..streams.foxglove import foxglove_module
    from ..streams.lsl import lsl_module
    from ..streams.replay import Replay
    from ..streams.session import SessionCalibration, prefer_side, read_calibration_file
    from ..streams.session_recording import Recorder, SessionRecording, check_recording
    from .config import read_config

    if record is not None:
        check_recording(record, force)
    if replay is None or lsl_out is not None:
        lsl_module()
    if foxglove is not None:
        foxglove_module()
    config, file = read_config(config_file), read_calibration_file(calibration_file)
    prefer = prefer_side(file)
    with StopRequest() as stop_request, ExitStack() as stack:
        sources: list[Source] = []
        played: Replay | None = None
        received: LslSource | None = None
        for each in sides:
            if replay is not None:
                played = Replay(replay, imus[each], skeleton, each, prefer, speed, latency_s, played)
                sources.append(played)
                continue
            received = lsl_source(
                imus[each],
                skeleton,
                each,
                prefer,
                body,
                gyro,
                further[each],
                wait_s,
                stop_request,
                stack,
                received,
            )
            if received is None:
                say("ended before the streams were there; nothing was recorded")
                return
            sources.append(received)
        infos = [source.info for source in sources]
        check_arms(infos, replay)
        calibrations = [SessionCalibration.of(file, info) for info in infos]
        for source, calibration in zip(sources, calibrations, strict=True):
            print_source(source, calibration)
        receivers = receivers_of(infos, foxglove, lsl_out, lsl_network, stack)
        recording = None
        if record is not None:
            growing = SessionRecording(record, infos[0], force, infos[1:])
            recording = Recorder(growing, patient=not sources[0].speed)
        sessions = stack.enter_context(
            engine_sessions(sources, calibrations, config, lag_s, recording, receivers)
        )
        figures = run_sessions(sessions, stop_request)
    write_json(json_file, together(infos, figures), force)
    for info, own in zip(infos, figures, strict=True):
        print_session(own, f"{info.side} arm, " if len(sides) > 1 else "")
    has_recording = recording is not None and recording.has_samples
    say_written(record if has_recording else None, json_file)
    if record is None or not has_recording:
        return
    arguments = ["smooth", str(record), "-o", str(recovered_name(record))]
    for option, value in (("--calibration", calibration_file), ("--config", config_file)):
        arguments += [] if value is None else [option, str(value)]
    if (then_smooth or stop_request.smooth) and not stop_request.killed:
        smooth_recording([*arguments, *(["--force"] if force else [])])
    else:
        say_command(*arguments)


def _check_use(
    record: Path | None,
    then_smooth: bool,
    replay: Path | None,
    of_streams: dict[str, str | None],
    others: dict[str, bool],
) -> None:
    """Refuse options that do not go together."""
    if then_smooth and record is None:
        raise typer.BadParameter("--then-smooth smooths what was recorded; give --record as well")
    for option, given in others.items():
        if given and replay is None:
            raise typer.BadParameter(f"{option} is of a replay; give --replay as well")
    for option, value in of_streams.items():
        if replay is not None and value is not None:
            raise typer.BadParameter(f"{option} is of a stream; a replay takes --imu and --skeleton")
    if record is not None:
        check_mcap(record)


def recovered_name(record: Path) -> Path:
    """Where the smoothed session goes."""
    return record.with_name(f"{record.stem}_recovered.mcap")
