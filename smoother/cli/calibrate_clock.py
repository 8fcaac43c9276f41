"""`unocclude calibrate clock`: the clocks of one session against each other."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .calibrate import error_prefix, load_existing_calibration, say_answer, write_answer
from .load import AS_USUAL, Solving, load_arm
from .options import (
    NO_FILES,
    Outputs,
)
from .output import print_table, say

if TYPE_CHECKING:
    from calib.clock.beeps import Beep
    from calib.clock.clock_calibration import ClockCalibration
    from calib.clock.links import Receptions
    from calib.clock.motion_clock import MotionClock

#: Clock of the sound, clock of the event time, by default.
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
        typer.Option("--broadcast", metavar="TIMES.csv", help="Receptions: round,node,t_s."),
    ] = None,
    motion: Annotated[
        Path | None,
        typer.Option(
            "--motion", metavar="REC.mcap", help="A recording with the arm in motion; needs no equipment."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="CAL.toml", help="Calibration file to store the offsets in."),
    ] = None,
    session: Annotated[
        str | None, typer.Option("--session", metavar="NAME", help="Name of the session in the file.")
    ] = None,
    sound_clocks: Annotated[
        str | None,
        typer.Option(
            "--sound-clocks",
            metavar="A,B",
            help="Clocks of the sound and of the event time.  [default: camera,base, or the node with"
            " `base` in its name]",
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
            "--audio-rate-hz", min=4000, help="Of a ROS audio topic (16-bit PCM), which does not state it."
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
        typer.Option(
            "--known", metavar="CAL.toml", help="With --motion: calibration file with the IMU's mounting."
        ),
    ] = None,
    solving: Solving = AS_USUAL,
    to: Outputs = NO_FILES,
) -> None:
    """Clock offsets and drift, by sound, broadcast or motion.

    t_to = t_from + offset. Offsets belong to this session: `smooth` takes them from this file as a prior.
    """
    from calib.clock.clock_calibration import calibrate_clocks, clock_answer
    from calib.clock.links import beep_receptions, beeps_of_tracks, buzzer_node
    from calib.clock.motion_clock import clock_from_motion

    from ..io.media.clock_files import read_broadcast, read_sound

    if sound is None and broadcast is None and motion is None:
        raise typer.BadParameter("give --sound with --event-time, --broadcast, --motion, or several of them")
    if (sound is None) != (not event_time):
        raise typer.BadParameter("--sound and --event-time belong together")
    if not all(isfinite(t) for t in event_time or []):
        raise typer.BadParameter("--event-time takes seconds on the IMU's clock")
    clocks = _two("--sound-clocks", sound_clocks or SOUND_CLOCKS)
    inputs = [sound, broadcast, motion, solving.config_file]
    load_existing_calibration(output, to, inputs, known=[known_file])
    receptions: list[Receptions] = []
    beeps: list[Beep] = []
    clock_in_motion: MotionClock | None = None
    origin_ns = 0
    notes: list[str] = []
    if broadcast is not None:
        receptions.append(read_broadcast(broadcast, 1e-3 * resolution_ms))
        if sound_clocks is None:
            clocks = clocks[0], buzzer_node(receptions[0].node, clocks[1])
    if sound is not None:
        tracks = read_sound(sound, audio_topic, audio_rate_hz, notes)
        with error_prefix(str(sound)):
            beeps = beeps_of_tracks(tracks, tone_hz, sound_start)
            own = beep_receptions(
                beeps,
                event_time or [],
                clocks,
                distance_m=distance_m,
                resolution_s=1e-3 * resolution_ms,
                source=f"sound {sound.name}",
            )
        receptions.insert(0, own)
    if motion is not None:
        config = solving.config()
        recording, known = load_arm(motion, known_file, solving.arm)
        names = _two("--motion-clocks", motion_clocks or f"camera,{recording.imu.name.rpartition('/')[2]}")
        clock_in_motion = clock_from_motion(recording, known, config, names)
        origin_ns = recording.origin_ns
        notes += recording.notes
    name = session or ", ".join(path.name for path in dict.fromkeys((sound, broadcast, motion)) if path)
    calibration = calibrate_clocks(name, receptions, beeps, clock_in_motion, origin_ns)
    answer = clock_answer(calibration)
    write_answer(answer, output, to, calibration, notes=notes)
    print_clocks(calibration)
    say_answer(answer, notes, output, to.json_file, to.report)


def _two(option: str, text: str) -> tuple[str, str]:
    names = [part.strip() for part in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise typer.BadParameter(f"{option} takes two names such as camera,base, not '{text}'")
    return names[0], names[1]


def print_clocks(calibration: ClockCalibration) -> None:
    """Print the beeps, and every two clocks that hang together."""
    from calib.clock.clock_calibration import link_words

    for beep in calibration.beeps:
        say(f"beep of {beep.frequency_hz:.0f} Hz: ends at {beep.end_s:.5f} s +- {1e3 * beep.sigma_s:.2f} ms")
    links = calibration.network.links()
    rows = [
        (
            link.from_clock,
            link.to_clock,
            f"{link.offset_s:+.6f}",
            f"{1e3 * link.sigma_s:.3f}",
            f"{link.skew_ppm:+.2f} +- {link.skew_sigma_ppm:.2f}",
        )
        for link in links
    ]
    print_table("Clocks: t_to = t_from + offset", ("from", "to", "offset, s", "sigma, ms", "skew, ppm"), rows)
    for link in links:
        say(link_words(link))
