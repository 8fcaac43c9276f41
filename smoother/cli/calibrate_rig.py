"""`unocclude calibrate panel`, `world` and `clock`: camera and base IMU from a panel; clocks of a session."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import options as o
from .calibrate import CalibrationOut, error_prefix, held
from .load import ConfigInput, Which, load_arm, refuse_twice

if TYPE_CHECKING:
    from calib.clock import MotionClock, Receptions
    from calib.images import View
    from calib.intrinsics import Intrinsics
    from calib.plane import Panel
    from calib.sound import Beep


def panel(
    output: o.CalibrationOutput,
    out: CalibrationOut,
    recording: Annotated[
        Path | None, o.argument("REC.mcap", "Images, lens and mocap markers, instead of files.")
    ] = None,
    depth: o.Depth = None,
    infrared: o.Infrared = None,
    markers: Annotated[
        o.Files,
        o.option(
            "Mocap markers of the same moment; CSV: marker,x,y,z in metres, any names and order.",
            metavar="M.csv|.trc|.c3d",
        ),
    ] = None,
    intrinsics: o.Intrinsics = None,
    panel: o.Panel = None,
    mocap_sigma_mm: Annotated[float, o.rare("Noise of a mocap marker, per axis.", min=0.001, max=20.0)] = 0.2,
) -> None:
    """The camera's pose in motion capture, from a marker panel.

    Hold the panel still in each pose; --depth, --infrared and --markers are given once per pose, in the same
    order. The result is added to the calibration file, with sigma and a verdict.

    Example: unocclude calibrate panel --depth d.png --infrared i.png --markers m.csv --intrinsics k.toml
    --panel panel.toml -o cal.toml
    """
    from calib.panel import calibrate_panel, panel_answer

    from ..io.tables.markers import read_positions

    held(output)
    known, lens = _known(panel, intrinsics)
    positions = [read_positions(path) for path in markers or []]
    notes: list[str] = []
    with pictured(output.with_name(f"{output.stem}.seen.png")):
        images = {"--depth": depth, "--infrared": infrared}
        if recording is None:
            views, lens = _views(images | {"--markers": markers}, lens)
        else:
            from ..io.rig.panel import read_panel_session

            _refuse_files(images)
            views, positions, lens = read_panel_session(recording, positions, lens, notes)
        calibration = calibrate_panel(views, positions, known, lens, 1e-3 * mocap_sigma_mm)
    out.finish(output, panel_answer(calibration), "Camera from motion capture, by the marker panel", notes)


def _known(panel: Path | None, intrinsics: Path | None) -> tuple[Panel, Intrinsics | None]:
    """The panel, and the lens where it is given."""
    from calib.intrinsics import read_intrinsics
    from calib.panel import read_panel

    if panel is None:
        raise typer.BadParameter("give --panel (marker positions and outline of the panel)")
    return read_panel(panel), read_intrinsics(intrinsics) if intrinsics is not None else None


def _refuse_files(files: dict[str, list[Path] | None]) -> None:
    if any(files.values()):
        raise typer.BadParameter(f"give either a recording or {', '.join(files)}, not both")


def _views(files: dict[str, list[Path] | None], lens: Intrinsics | None) -> tuple[list[View], Intrinsics]:
    """The views of files that are given once per pose, depth and infrared first, and their lens."""
    from calib.images import read_view

    *first, last = files
    names = f"{', '.join(first)} and {last}"
    given = [paths or [] for paths in files.values()]
    counts = [len(paths) for paths in given]
    if not counts[0]:
        raise typer.BadParameter(f"give {names} once per pose, or a recording")
    if len(set(counts)) > 1:
        raise typer.BadParameter(
            f"{names} must be given alike often, once per pose; they are"
            f" given {', '.join(map(str, counts[:-1]))} and {counts[-1]} times"
        )
    if lens is None:
        raise typer.BadParameter("give --intrinsics with --depth")
    for name in ("--depth", "--infrared", "--markers"):
        refuse_twice(files.get(name) or [], f"{name} ")
    return [read_view(d, i) for d, i in zip(*given[:2], strict=True)], lens


@contextmanager
def pictured(path: Path) -> Iterator[None]:
    """Where the markers could not be identified, write a picture of what was seen, and print its path."""
    from calib.panel import NotIdentified

    try:
        yield
    except NotIdentified as error:
        if error.view is None or error.blobs is None:
            raise
        from calib.images import drawn_spots

        from ..runtime.outputs import writing

        with writing(path, force=True) as temporary:
            temporary.write_bytes(drawn_spots(error.view.infrared, error.blobs))
        text = str(error).rstrip(".")
        raise NotIdentified(f"{text}; what was seen is drawn in {path}.") from error


def world(
    output: o.CalibrationOutput,
    out: CalibrationOut,
    recording: Annotated[
        Path | None, o.argument("[REC.mcap]", "The session with images, lens and both IMUs.")
    ] = None,
    depth: o.Depth = None,
    infrared: o.Infrared = None,
    panel_imu: Annotated[
        o.Files,
        o.option(
            "Samples of the IMU on the panel in that pose: t_s, ax, ay, az, gx, gy, gz [, mx, my, mz].",
            metavar="P.csv",
        ),
    ] = None,
    base_imu: Annotated[o.Files, o.option("Those of the IMU on the camera.", metavar="B.csv")] = None,
    intrinsics: o.Intrinsics = None,
    panel: o.Panel = None,
    panel_topic: Annotated[str, o.rare("In a recording: the IMU on the panel.", metavar="TOPIC")] = "panel",
    base_topic: Annotated[str, o.rare("In a recording: the IMU on the camera.", metavar="TOPIC")] = "base",
) -> None:
    """The orientation of an IMU on the camera, for gravity.

    Hold the panel, with an IMU on it, still for two seconds in each pose. From a recording of the whole
    session the gyroscopes link the poses; from files each pose is independent. The result is added to
    the calibration file; `smooth --calibration` then takes gravity from the recording's base IMU.

    Example: unocclude calibrate world session.mcap --panel panel.toml -o cal.toml
    """
    from calib.world import calibrate_world_from_views, common_time, world_answer

    files = {"--depth": depth, "--infrared": infrared, "--panel-imu": panel_imu, "--base-imu": base_imu}
    there = held(output)
    known, lens = _known(panel, intrinsics)
    notes: list[str] = []
    if recording is not None:
        from ..io.rig.panel import read_session

        _refuse_files(files)
        views, times, imus, lens, notes = read_session(recording, panel_topic, base_topic, lens)
        panels, bases = ([imu] * len(views) for imu in imus)
    else:
        from ..io.tables.columns import read_imu_table

        views, lens = _views(files, lens)
        panels = [read_imu_table(path, "panel") for path in panel_imu or []]
        bases = [read_imu_table(path, "base") for path in base_imu or []]
        times = []
        for own, base, path in zip(panels, bases, panel_imu or [], strict=True):
            with error_prefix(f"{path} and the base IMU's file of that pose"):
                times.append(common_time(own, base))
    with pictured(output.with_name(f"{output.stem}.seen.png")):
        calibration = calibrate_world_from_views(views, times, panels, bases, known, lens, there)
    out.finish(output, world_answer(calibration), "Camera from base IMU, by the panel", notes)


def clock(
    which: Which,
    settings: ConfigInput,
    out: CalibrationOut,
    sound: Annotated[
        Path | None, o.option("The camera's sound: WAV, or MCAP with an audio topic.", metavar="BEEP.wav")
    ] = None,
    event_time: Annotated[
        list[float] | None,
        o.option("When the beep ended on the IMU's clock, s; once for each beep.", metavar="T"),
    ] = None,
    broadcast: Annotated[Path | None, o.option("Receptions: round,node,t_s.", metavar="TIMES.csv")] = None,
    motion: Annotated[
        Path | None, o.option("A recording with the arm in motion; no equipment.", metavar="REC.mcap")
    ] = None,
    known: Annotated[
        o.File,
        o.option("With --motion: calibration with the IMU's mounting.", metavar="CAL.toml"),
        o.SHARED,
    ] = None,
    output: Annotated[
        o.File,
        o.option("Calibration file for the offsets.", "-o", "--output", metavar="CAL.toml"),
        o.ADDED_TO,
    ] = None,
    session: Annotated[str | None, o.option("Name of the session in the file.", metavar="NAME")] = None,
    sound_clocks: Annotated[
        str | None,
        o.rare(
            "Of sound and event time.  [default: camera,base, or the node with `base` in its name]",
            metavar="A,B",
        ),
    ] = None,
    motion_clocks: Annotated[
        str | None, o.rare("Camera's and IMU's clock [camera, the IMU's name].", metavar="A,B")
    ] = None,
    audio_topic: Annotated[str | None, o.rare("The audio, where there are several.", metavar="TOPIC")] = None,
    sound_start: Annotated[
        float, o.rare("Time of a WAV's first sample on the sound's clock.", metavar="S")
    ] = 0.0,
    tone_hz: Annotated[float | None, o.rare("The buzzer's tone, where it is known.")] = None,
    distance_m: Annotated[float, o.rare("Buzzer to microphone.", min=0.0, max=20.0)] = 0.0,
    resolution_ms: Annotated[float, o.rare("Step of broadcast and event stamps.", min=1e-6)] = 0.3125,
) -> None:
    """Clock offsets and drift, by sound, broadcast or motion.

    t_to = t_from + offset. Offsets belong to this session: `smooth` takes them from this file as a prior.

    Example: unocclude calibrate clock --sound beep.wav --event-time 12.3456 --broadcast times.csv
    """
    from calib.clock import clock_answer, clock_from_motion
    from calib.sound import beep_receptions, beeps_of_tracks, buzzer_node

    from ..io.rig.clock import read_broadcast, read_sound

    if sound is None and broadcast is None and motion is None:
        raise typer.BadParameter("give --sound with --event-time, --broadcast, --motion, or several of them")
    if (sound is None) != (not event_time):
        raise typer.BadParameter("--sound and --event-time belong together")
    if not all(isfinite(t) for t in event_time or []):
        raise typer.BadParameter("--event-time takes seconds on the IMU's clock")
    clocks = _two("--sound-clocks", sound_clocks or "camera,base")
    held(output)
    receptions: list[Receptions] = []
    beeps: list[Beep] = []
    moved: MotionClock | None = None
    origin_ns = 0
    notes: list[str] = []
    if broadcast is not None:
        receptions.append(read_broadcast(broadcast, 1e-3 * resolution_ms))
        if sound_clocks is None:
            clocks = clocks[0], buzzer_node(receptions[0].node, clocks[1])
    if sound is not None:
        read = read_sound(sound, audio_topic, notes)
        tracks = ((each.samples, each.rate_hz, each.start_s) for each in read)
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
        recording, given = load_arm(motion, known, **which.chosen)
        names = _two("--motion-clocks", motion_clocks or f"camera,{recording.imu.name.rpartition('/')[2]}")
        moved, origin_ns = clock_from_motion(recording, given, settings.read(), names), recording.origin_ns
        notes += recording.notes
    name = session or ", ".join(path.name for path in dict.fromkeys((sound, broadcast, motion)) if path)
    answer = clock_answer(name, receptions, beeps, moved, origin_ns)
    out.finish(output, answer, f"Clocks: {name}", notes)


def _two(option: str, text: str) -> tuple[str, str]:
    names = [part.strip() for part in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise typer.BadParameter(f"{option} takes two names such as camera,base, not '{text}'")
    return names[0], names[1]
