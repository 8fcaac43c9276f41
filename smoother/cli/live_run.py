"""A session put together, run, and summed up."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from .live_dashboard import Dashboard, Lines, Table
from .output import print_notes, say
from .stop_request import StopRequest

if TYPE_CHECKING:
    from ..config import Config
    from ..streams.arrivals import Source, SourceInfo
    from ..streams.session import LiveSession, Receiver, SessionCalibration
    from ..streams.session_recording import SessionRecording


def lsl_source(
    imu: str | None,
    skeleton: str | None,
    side: str | None,
    prefer_side: str | None,
    wait_s: float,
    stop_request: StopRequest,
    stack: ExitStack,
) -> Source | None:
    """Streams of the Lab Streaming Layer, once both are there; None where it was ended before."""
    from ..streams.lsl_source import LslSource

    source = LslSource(imu, skeleton, side, prefer_side)
    stack.callback(source.close)
    say(f"waiting for the streams, at most {wait_s:g} s")
    return source if source.open(wait_s, stop_request, say) else None


def receivers_of(
    info: SourceInfo, foxglove: int | None, lsl_out: str | None, stack: ExitStack
) -> list[Receiver]:
    """Who is sent the answers, and where they are found."""
    receivers: list[Receiver] = []
    if foxglove is not None:
        from ..streams.foxglove import FoxgloveServer

        server = FoxgloveServer(info, foxglove)
        stack.callback(server.close)
        say(f"Foxglove: open connection, Foxglove WebSocket, {server.address}; layout:"
            " docs/unocclude.foxglove-layout.json")  # fmt: skip
        receivers.append(server)
    if lsl_out is not None:
        from ..streams.lsl import LslOutlet

        receivers.append(LslOutlet(lsl_out, info))
        stack.callback(receivers[-1].close)
        say(f"LSL: streams {lsl_out} and {lsl_out}_settled, for all computers of this network")
    return receivers


@contextmanager
def engine_session(
    source: Source,
    calibration: SessionCalibration,
    config: Config,
    lag_s: float,
    recording: SessionRecording | None,
    receivers: Sequence[Receiver],
) -> Iterator[LiveSession]:
    """A session; whatever ends it, its recording is whole."""
    from ..live.calibrations import InlineCalibrator
    from ..live.smoother import LiveSmoother
    from ..streams.session import LiveSession

    info = source.info
    with ExitStack() as stack:
        if recording is not None:
            stack.callback(recording.close)
        engine = LiveSmoother(
            info.side,
            calibration.arm,
            calibration.config(config),
            lag_s,
            info.gravity_hint,
            info.camera_frame,
            None if source.speed else InlineCalibrator(),  # nobody waits for the background either
        )
        stack.enter_context(engine)
        yield LiveSession(source, engine, calibration, recording, receivers)


def run_session(session: LiveSession, stop_request: StopRequest) -> dict[str, Any]:
    """Run a session until it ends, and show it; its figures."""
    if sys.stdout.isatty():
        keys = "q ends, s ends and smooths" if stop_request.has_keys else "Ctrl-C ends"
        dashboard: Dashboard = Table(f"unocclude live ({keys})")
    else:
        dashboard = Lines()
    with dashboard:
        return session.run(stop_request, dashboard.show).figures()


def print_source(source: Source, calibration: SessionCalibration) -> None:
    """Say what is used."""
    info = source.info
    arm = f"{info.side} arm" if info.side else "arm"
    say(f"IMU {info.imu}, {arm} of {info.skeleton} ({', '.join(info.joints)})")
    print_notes([*info.notes, *calibration.notes])


def print_session(figures: dict[str, Any]) -> None:
    """Print what the session was like."""
    state = figures["state_s"]
    say(
        f"{figures['seconds']:.1f} s: visible {state['visible']:.1f} s, {figures['gaps']} gaps of"
        f" {state['gap']:.1f} s, the longest {figures['longest_gap_s']:.1f} s; calibrating"
        f" {state['calibrating']:.1f} s, the IMU lost {state['lost']:.1f} s"
    )
    for name, stream in (("IMU", figures["imu"]), ("camera", figures["skeleton"])):
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
