"""`unocclude simulate clock`: a beep, broadcasts and an arm in motion on clocks that are known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import Force, Json, Seed
from .output import check_outputs, print_table, say, say_command, say_written, truth_text, write_json
from .simulate_panel import Folder

if TYPE_CHECKING:
    from ..simulation.clocks import ClockSession


def clock(
    output: Folder,
    rounds: Annotated[int, typer.Option("--rounds", min=4, max=1000, help="Broadcasts.")] = 20,
    minutes: Annotated[
        float, typer.Option("--minutes", min=0.5, max=120.0, help="Time over which they are spread.")
    ] = 5.0,
    motion_s: Annotated[
        float, typer.Option("--motion-s", min=10.0, max=600.0, help="Length of the arm's recording.")
    ] = 30.0,
    noise_db: Annotated[
        float, typer.Option("--noise-db", min=0.0, max=80.0, help="Noise of the room below the beep, dB.")
    ] = 25.0,
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Simulate a beep, broadcasts and motion on known clocks.

    Writes beep.wav, times.csv, session.mcap and truth.toml. The IMU's clock runs 390 ppm fast.
    """
    from ..io.media.clock_files import MOTION, SOUND, TIMES, write_clock_folder
    from ..io.media.panel_writing import check_folder
    from ..simulation.clocks import simulate_clock_session

    check_folder(output, force)
    check_outputs(force, [json_file])
    session = simulate_clock_session(
        seed, rounds=rounds, minutes=minutes, motion_s=motion_s, noise_db=noise_db
    )
    truth = {"clock": {"links": true_links(session)}}
    write_clock_folder(
        output,
        session.sound,
        session.sound_rate_hz,
        session.receptions,
        session.recording,
        truth_text(truth),
        force=force,
    )
    write_json(json_file, {"seed": seed, "event_time_s": session.event_time_s, "truth": truth}, force)
    rows = [
        (link["from"], link["to"], f"{link['offset_s']:+.6f}", f"{link['skew_ppm']:.2f}")
        for link in truth["clock"]["links"]
    ]
    print_table(
        "True clocks at time 0: t_to = t_from + offset", ("from", "to", "offset, s", "skew, ppm"), rows
    )
    say(f"the beep ended at {session.event_time_s:.7f} s on the base's clock")
    say_written(output, json_file)
    say_command(
        *("calibrate", "clock", "--sound", output / SOUND, "--event-time", f"{session.event_time_s:.7f}"),
        *("--broadcast", output / TIMES, "--motion", output / MOTION, "-o", "clock.toml"),
    )


def true_links(session: ClockSession) -> list[dict[str, Any]]:
    """Every clock against every other at time 0 of the first, as the calibration file states links."""
    from ..simulation.clocks import BASE, CAMERA, IMU

    links = []
    for first, second in ((CAMERA, BASE), (CAMERA, IMU), (BASE, IMU)):
        at_zero, later = (session.offset_s(first, second, at_s) for at_s in (0.0, 1000.0))
        links.append(
            {
                "from": first,
                "to": second,
                "at_s": 0.0,
                "offset_s": at_zero,
                "skew_ppm": 1e6 * (later - at_zero) / 1000.0 + 0.0,
            }
        )
    return links
