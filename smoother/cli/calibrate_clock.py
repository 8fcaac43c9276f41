"""`unocclude calibrate clock`: the clocks of one session against each other."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import UnoccludeError
from .load import load_arm
from .options import Body, ConfigFile, Force, Imu, Json, Processes, Report, Side, Skeleton, one_side
from .output import check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from calib.clock.beeps import Beep
    from calib.clock.links import ClockLink, ClockNetwork, Receptions
    from calib.clock.motion_clock import MotionClock

#: Speed of sound in a room, m/s.
SOUND_M_S = 343.0
#: Clock of the sound, clock of the event time, where nobody names them.
SOUND_CLOCKS = "camera,base"


def clock(
    sound: Annotated[
        Path | None,
        typer.Option(
            "--sound", metavar="BEEP.wav", help="The camera's sound: WAV, or MCAP with an audio topic."
        ),
    ] = None,
    event_time: Annotated[
        list[float] | None,
        typer.Option(
            "--event-time", metavar="T", help="When the beep ended on the IMU's clock, s; once for each beep."
        ),
    ] = None,
    broadcast: Annotated[
        Path | None,
        typer.Option("--broadcast", metavar="TIMES.csv", help="round,node,t_s: who received what when."),
    ] = None,
    motion: Annotated[
        Path | None,
        typer.Option(
            "--motion", metavar="REC.mcap", help="No equipment: a recording with the arm in motion."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="CAL.toml", help="Also keep the links, as this session's."),
    ] = None,
    session: Annotated[
        str | None, typer.Option("--session", metavar="NAME", help="What to call the session in the file.")
    ] = None,
    sound_clocks: Annotated[
        str | None,
        typer.Option(
            "--sound-clocks",
            metavar="A,B",
            help="Clock of the sound, clock of the event time [camera,base, or the one node with `base` in"
            " its name].",
        ),
    ] = None,
    motion_clocks: Annotated[
        str | None,
        typer.Option(
            "--motion-clocks", metavar="A,B", help="Camera's and IMU's clock [camera, the IMU's name]."
        ),
    ] = None,
    audio_topic: Annotated[
        str | None, typer.Option("--audio-topic", metavar="TOPIC", help="The audio, where there are several.")
    ] = None,
    audio_rate_hz: Annotated[
        int,
        typer.Option(
            "--audio-rate-hz", min=4000, help="Of a ROS audio topic (16-bit PCM), which does not say."
        ),
    ] = 16000,
    sound_start: Annotated[
        float,
        typer.Option("--sound-start", metavar="S", help="Time of a WAV's first sample on the sound's clock."),
    ] = 0.0,
    tone_hz: Annotated[
        float | None, typer.Option("--tone-hz", help="The buzzer's tone, where it is known.")
    ] = None,
    distance_m: Annotated[
        float, typer.Option("--distance-m", min=0.0, max=20.0, help="Buzzer to microphone.")
    ] = 0.0,
    resolution_ms: Annotated[
        float,
        typer.Option("--resolution-ms", min=1e-6, help="Step of the broadcast's and the event's stamps."),
    ] = 0.3125,
    known_file: Annotated[
        Path | None,
        typer.Option("--known", metavar="CAL.toml", help="With --motion: how the IMU sits on the arm."),
    ] = None,
    config_file: ConfigFile = None,
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    processes: Processes = None,
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find offset and skew between the clocks of one session: by sound, by broadcast, by motion, or chained.

    t_to = t_from + offset. Offsets belong to this session: `smooth` finds its own and takes none from a file.
    """
    from calib.clock.clock_summary import disagreements, link_words, open_questions
    from calib.clock.network import solve_clocks

    if sound is None and broadcast is None and motion is None:
        raise typer.BadParameter("give --sound with --event-time, --broadcast, --motion, or several of them")
    if (sound is None) != (not event_time):
        raise typer.BadParameter("--sound and --event-time belong together")
    if not all(isfinite(each) for each in event_time or []):
        raise typer.BadParameter("--event-time takes seconds on the IMU's clock")
    pair = _two("--sound-clocks", sound_clocks or SOUND_CLOCKS)
    inputs = [path for path in dict.fromkeys((sound, broadcast, motion, config_file)) if path is not None]
    check_outputs(True, [output], [*inputs])
    check_outputs(force, [json_file, report], [*inputs, known_file])
    if output is not None and output.exists():
        from calib.file import read_calibration

        read_calibration(output)
    heard: list[Receptions] = []
    links: list[ClockLink] = []
    beeps: list[Beep] = []
    found: MotionClock | None = None
    notes: tuple[str, ...] = ()
    told = None
    if broadcast is not None:
        from ..io.plain.clock_times import read_broadcast

        told = read_broadcast(broadcast, 1e-3 * resolution_ms)
        if sound_clocks is None:
            pair = pair[0], _base(told.node, pair[1])
    if sound is not None:
        own, beeps = _sound(
            sound,
            event_time or [],
            pair,
            audio_topic,
            audio_rate_hz,
            sound_start,
            tone_hz,
            distance_m,
            resolution_ms,
        )
        heard.append(own)
    if told is not None:
        heard.append(told)
    if motion is not None:
        from dataclasses import replace

        from calib.clock.motion_clock import clock_from_motion

        from .config_file import read_config, with_processes

        config = with_processes(read_config(config_file), processes)
        recording, known = load_arm(
            motion, known_file, imu=imu, skeleton=skeleton, side=one_side(side), body=body
        )
        names = _two("--motion-clocks", motion_clocks or f"camera,{recording.imu.name.rpartition('/')[2]}")
        found = clock_from_motion(recording, known, config, names)
        notes = recording.notes
        # other sources count from the clocks' own zero, the recording from its origin
        links.append(replace(found.link, at_s=found.link.at_s + 1e-9 * recording.origin_ns))
    network = solve_clocks(heard, links)
    name = session or ", ".join(path.name for path in dict.fromkeys((sound, broadcast, motion)) if path)
    left_open = [*disagreements(network), *open_questions(network, heard, beeps, found)]
    if output is not None:
        from calib.file import CalibrationFile, write_calibration

        write_calibration(output, CalibrationFile().with_table("clock", _table(name, network)))
    write_json(json_file, _figures(name, network, beeps, left_open), force)
    if report is not None:
        from ..report.clock import write_clock_report

        write_clock_report(report, name, network, heard, beeps, found, force=force)
    for beep in beeps:
        say(f"beep of {beep.frequency_hz:.0f} Hz: ends at {beep.end_s:.5f} s +- {1e3 * beep.sigma_s:.2f} ms")
    _print(network)
    for link in network.links():
        say(link_words(link))
    for sentence in left_open:
        say(f"not determined: {sentence}")
    say(
        "A clock offset belongs to its recording: measure it anew for every session, it is never carried"
        " over."
    )
    print_notes(notes)
    if output is not None or json_file is not None or report is not None:
        say_written(output, json_file, report)


def _base(nodes: Sequence[str], usual: str) -> str:
    """The broadcast's one node that is called base something, whose buzzer the camera heard."""
    named = [name for name in dict.fromkeys(nodes) if usual in name.lower()]
    return named[0] if len(named) == 1 else usual


def _two(option: str, text: str) -> tuple[str, str]:
    names = [part.strip() for part in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise typer.BadParameter(f"{option} takes two names such as camera,base, not '{text}'")
    return names[0], names[1]


def _sound(
    path: Path,
    times: list[float],
    pair: tuple[str, str],
    topic: str | None,
    ros_rate_hz: int,
    start_s: float,
    tone_hz: float | None,
    distance_m: float,
    resolution_ms: float,
) -> tuple[Receptions, list[Beep]]:
    """The beeps' ends on both clocks."""
    from dataclasses import replace

    import numpy as np

    from calib.clock.beeps import find_beeps
    from calib.clock.links import Receptions

    from ..io.media.audio import read_sound

    beeps: list[Beep] = []
    reason: UnoccludeError | None = None
    for track in read_sound(path, topic, ros_rate_hz):
        try:
            found = find_beeps(track.samples, track.rate_hz, tone_hz)
        except UnoccludeError as error:
            reason = error
            continue
        shift = track.start_s + start_s
        beeps += [
            replace(beep, start_s=beep.start_s + shift, end_s=beep.end_s + shift, t_s=beep.t_s + shift)
            for beep in found
        ]
    if not beeps and reason is not None:
        raise UnoccludeError(f"{path}: {reason}")
    if len(beeps) != len(times):
        ends = ", ".join(f"{beep.end_s:.2f} s" for beep in beeps[:12]) + (", .." if len(beeps) > 12 else "")
        raise UnoccludeError(
            f"{path}: beeps that end in it: {len(beeps)} ({ends}), event times given: {len(times)}; give one"
            " --event-time for each beep, cut the sound, or name the buzzer's tone with --tone-hz"
        )
    sigma_event = 1e-3 * resolution_ms / np.sqrt(12)
    flown = distance_m / SOUND_M_S
    heard = Receptions(
        event=np.repeat(np.arange(len(beeps)), 2),
        node=[name for _ in beeps for name in pair],
        t_s=np.array(
            [t for beep, time in zip(beeps, sorted(times), strict=True) for t in (beep.end_s - flown, time)]
        ),
        sigma_s=np.array([sigma for beep in beeps for sigma in (beep.sigma_s, sigma_event)]),
        source=f"sound {path.name}",
        estimate_noise=len(beeps) > 2,
    )
    return heard, beeps


def _link_figures(network: ClockNetwork) -> list[dict[str, Any]]:
    return [
        {
            "from": link.from_clock,
            "to": link.to_clock,
            "offset_s": float(link.offset_s),
            "sigma_s": float(link.sigma_s),
            "skew_ppm": float(link.skew_ppm),
            "skew_sigma_ppm": float(link.skew_sigma_ppm),
            "at_s": float(link.at_s),
        }
        for link in network.links()
    ]


def _figures(name: str, network: ClockNetwork, beeps: list[Beep], left_open: list[str]) -> dict[str, Any]:
    """What was found, as plain values for `--json`."""
    return {
        "session": name,
        "links": _link_figures(network),
        "sources": [
            {
                "source": left.source,
                "sigma_s": left.sigma_s,
                "used": int(left.used.sum()),
                "set_aside": int((~left.used).sum()),
                "largest_residual_s": float(abs(left.residual_s[left.used]).max(initial=0.0)),
            }
            for left in network.leftovers
        ],
        "beeps": [
            {
                "end_s": beep.end_s,
                "sigma_s": beep.sigma_s,
                "frequency_hz": beep.frequency_hz,
                "above_quiet_db": beep.above_quiet_db,
            }
            for beep in beeps
        ],
        "not_determined": left_open,
    }


def _table(name: str, network: ClockNetwork) -> dict[str, Any]:
    """The file's table [clock]; it is a note of this session, which recovering does not read."""
    return {"session": name, "valid_for": "this session alone", "links": _link_figures(network)}


def _print(network: ClockNetwork) -> None:
    rows = [
        (
            link.from_clock,
            link.to_clock,
            f"{link.offset_s:+.6f}",
            f"{1e3 * link.sigma_s:.3f}",
            f"{link.skew_ppm:+.2f} +- {link.skew_sigma_ppm:.2f}",
        )
        for link in network.links()
    ]
    print_table("Clocks: t_to = t_from + offset", ("from", "to", "offset, s", "sigma, ms", "skew, ppm"), rows)
