"""`unocclude live`: the arm while it moves."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from .live_run import (
    engine_session,
    lsl_source,
    print_session,
    print_source,
    receivers_of,
    run_session,
    smooth_recording,
)
from .options import Calibration, ConfigFile, Force, Json, Side, one_side
from .output import check_mcap, check_outputs, say, say_command, say_written, write_json
from .stop_request import StopRequest

if TYPE_CHECKING:
    from ..streams.arrivals import Source

_FOXGLOVE, _PORT = "--foxglove", 8765


class LiveCommand(TyperCommand):
    """Lets `--foxglove` stand alone: the port is then the one that Foxglove proposes."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a `--foxglove` that no number follows its port."""
        complete: list[str] = []
        for place, arg in enumerate(args):
            complete.append(arg)
            follows = args[place + 1] if place + 1 < len(args) else "-"
            if arg == _FOXGLOVE and follows.startswith("-"):
                complete.append(str(_PORT))
        return list(super().parse_args(ctx, complete))


def live(
    imu: Annotated[
        str | None,
        typer.Option("--imu", metavar="STREAM", help="Name of the IMU's LSL stream; a topic with --replay."),
    ] = None,
    skeleton: Annotated[
        str | None,
        typer.Option(
            "--skeleton", metavar="STREAM", help="Name of the skeleton's LSL stream; a topic with --replay."
        ),
    ] = None,
    side: Side = None,
    calibration_file: Calibration = None,
    config_file: ConfigFile = None,
    lag_s: Annotated[
        float,
        typer.Option(
            "--lag", metavar="S", min=0.0, max=2.0, help="How long after its moment the settled answer comes."
        ),
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
        typer.Option("--replay", metavar="REC.mcap", help="Play a recording as if it happened now."),
    ] = None,
    speed: Annotated[
        float,
        typer.Option("--speed", metavar="X", min=0.0, help="Of the replay; 0 as fast as this computer can."),
    ] = 1.0,
    latency_s: Annotated[
        float | None,
        typer.Option(
            "--latency",
            metavar="S",
            min=0.0,
            max=2.0,
            help="Of the camera in a replay; by default what the recording says, else 0.1 s.",
        ),
    ] = None,
    foxglove: Annotated[
        int | None,
        typer.Option(
            _FOXGLOVE,
            metavar="[PORT]",
            min=0,
            max=65535,
            help=f"Show it in Foxglove, on this computer's port {_PORT} or another (0: a free one).",
        ),
    ] = None,
    lsl_out: Annotated[
        str | None,
        typer.Option("--lsl-out", metavar="NAME", help="Send the arm as LSL streams NAME and NAME_settled."),
    ] = None,
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0.0, help="How long to wait for the streams.")
    ] = 30.0,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Recover the arm while it moves: where it is now, and where it was a lag ago, with sigma.

    Streams come from the Lab Streaming Layer, with labelled channels and units. Ctrl-C (or q) ends the
    session and leaves a whole recording; s ends it and smooths the recording. Needs
    `pip install '.[live]'`.
    """
    side = one_side(side)
    _check_use(record, then_smooth, replay, {"--speed": speed != 1.0, "--latency": latency_s is not None})
    recovered = recovered_name(record) if record is not None and then_smooth else None
    check_outputs(force, [record, recovered, json_file], [calibration_file, config_file, replay])
    from ..streams.foxglove import foxglove_module
    from ..streams.lsl import lsl_module
    from ..streams.replay import Replay
    from ..streams.session import SessionCalibration, prefer_side, read_calibration_file
    from ..streams.session_recording import SessionRecording, check_recording
    from .config_file import read_config

    if record is not None:
        check_recording(record, force)
    if replay is None or lsl_out is not None:
        lsl_module()
    if foxglove is not None:
        foxglove_module()
    config, calibrations = read_config(config_file), read_calibration_file(calibration_file)
    prefer = prefer_side(calibrations)
    with StopRequest() as stop_request, ExitStack() as stack:
        if replay is not None:
            source: Source | None = Replay(replay, imu, skeleton, side, prefer, speed, latency_s)
        else:
            source = lsl_source(imu, skeleton, side, prefer, wait_s, stop_request, stack)
        if source is None:
            say("ended before the streams were there; nothing was recorded")
            return
        calibration = SessionCalibration.of(calibrations, source.info)
        print_source(source, calibration)
        receivers = receivers_of(source.info, foxglove, lsl_out, stack)
        recording = None if record is None else SessionRecording(record, source.info, force)
        session = stack.enter_context(
            engine_session(source, calibration, config, lag_s, recording, receivers)
        )
        figures = run_session(session, stop_request)
    write_json(json_file, figures, force)
    print_session(figures)
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


def _check_use(record: Path | None, then_smooth: bool, replay: Path | None, others: dict[str, bool]) -> None:
    """Refuse options that do not go together."""
    if then_smooth and record is None:
        raise typer.BadParameter("--then-smooth smooths what was recorded; give --record as well")
    for option, given in others.items():
        if given and replay is None:
            raise typer.BadParameter(f"{option} is of a replay; give --replay as well")
    if record is not None:
        check_mcap(record)


def recovered_name(record: Path) -> Path:
    """Where the smoothed session goes."""
    return record.with_name(f"{record.stem}_recovered.mcap")
