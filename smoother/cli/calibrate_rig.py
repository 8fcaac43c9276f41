"""`unocclude calibrate panel`, `world` and `clock`: camera and base IMU from a panel; clocks of a session."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import options as o
from .calibrate import CalibrationOut, error_prefix, held
from .load import ConfigInput, Which, load_arm, refuse_twice

if TYPE_CHECKING:
    from calib.clock import MotionClock, Receptions
    from calib.images import Panel, View
    from calib.intrinsics import Intrinsics
    from calib.sound import Beep


@dataclass(frozen=True)
class PanelInput:
    """The panel, the lens, and images of the panel as files, once per pose."""

    depth: o.Depth = None
    infrared: o.Infrared = None
    intrinsics: o.Intrinsics = None
    panel: o.Panel = None

    def known(self) -> tuple[Panel, Intrinsics | None]:
        """The panel, and the lens where it is given."""
        from calib.intrinsics import read_intrinsics
        from calib.panel import read_panel

        if self.panel is None:
            raise typer.BadParameter("give --panel (marker positions and outline of the panel)")
        return read_panel(self.panel), read_intrinsics(self.intrinsics) if self.intrinsics else None

    def check(self, recording: Path | None, further: dict[str, o.Files]) -> None:
        """Refuse images beside a recording, and files that are not given alike often, once per pose."""
        files = {"--depth": self.depth, "--infrared": self.infrared} | further
        counts = [len(paths or []) for paths in files.values()]
        *first, last = files
        names = f"{', '.join(first)} and {last}"
        o.refuse(
            {
                "give either a recording or --depth and --infrared, not both": recording and any(counts[:2]),
                f"give {names} once per pose, or a recording": not recording and not counts[0],
                f"{names} must be given alike often, once per pose; they are given"
                f" {', '.join(map(str, counts[:-1]))} and {counts[-1]} times": (
                    not recording and len(set(counts)) > 1
                ),
                "give --intrinsics with --depth": not recording and self.intrinsics is None,
            }
        )
        for name in ("--depth", "--infrared", "--markers"):
            refuse_twice(files.get(name) or [], f"{name} ")

    def views(self) -> list[View]:
        """The images, a pose each."""
        from calib.images import read_view

        return [read_view(*pair) for pair in zip(self.depth or [], self.infrared or [], strict=True)]


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


_MARKERS = "Mocap markers of the same moment; CSV: marker,x,y,z in metres, any names and order."
_PANEL_IMU = "Samples of the IMU on the panel in that pose: t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]."


def panel(
    output: o.CalibrationOutput,
    out: CalibrationOut,
    seen: PanelInput,
    recording: Annotated[
        Path | None, o.argument("REC.mcap", "Images, lens and mocap markers, instead of files.")
    ] = None,
    markers: Annotated[o.Files, o.value("M.csv|.trc|.c3d", _MARKERS)] = None,
    mocap_sigma_mm: Annotated[float, o.rare("Noise of a mocap marker, per axis.", min=0.001, max=20.0)] = 0.2,
) -> None:
    """The camera's pose in motion capture, from a marker panel.

    Hold the panel still in each pose; --depth, --infrared and --markers are given once per pose, in the same
    order. The result is added to the calibration file, with sigma and a verdict.

    Example: unocclude calibrate panel --depth d.png --infrared i.png --markers m.csv --intrinsics k.toml
    --panel panel.toml -o cal.toml
    """
    from calib.panel import calibrate_panel, panel_answer

    from ..io.rig.panel import read_panel_session
    from ..io.tables.markers import read_positions

    held(output)
    known, lens = seen.known()
    positions = [read_positions(path) for path in markers or []]
    notes: list[str] = []
    with pictured(output.with_name(f"{output.stem}.seen.png")):
        seen.check(recording, {"--markers": markers})
        if recording is not None:
            views, positions, lens = read_panel_session(recording, positions, lens, notes)
        else:
            views = seen.views()
        assert lens is not None
        calibration = calibrate_panel(views, positions, known, lens, 1e-3 * mocap_sigma_mm)
    out.finish(output, panel_answer(calibration), "Camera from motion capture, by the marker panel", notes)


def world(
    output: o.CalibrationOutput,
    out: CalibrationOut,
    seen: PanelInput,
    recording: Annotated[
        Path | None, o.argument("[REC.mcap]", "The session with images, lens and both IMUs.")
    ] = None,
    panel_imu: Annotated[o.Files, o.value("P.csv", _PANEL_IMU)] = None,
    base_imu: Annotated[o.Files, o.value("B.csv", "Those of the IMU on the camera.")] = None,
    panel_topic: Annotated[str, o.rare_value("TOPIC", "In a recording: the IMU on the panel.")] = "panel",
    base_topic: Annotated[str, o.rare_value("TOPIC", "In a recording: the IMU on the camera.")] = "base",
) -> None:
    """The orientation of an IMU on the camera, for gravity.

    Hold the panel, with an IMU on it, still for two seconds in each pose. From a recording of the whole
    session the gyroscopes link the poses; from files each pose is independent. The result is added to
    the calibration file; `smooth --calibration` then takes gravity from the recording's base IMU.

    Example: unocclude calibrate world session.mcap --panel panel.toml -o cal.toml
    """
    from calib.world import calibrate_world_from_views, common_time, world_answer

    from ..io.rig.panel import read_session
    from ..io.tables.columns import read_imu_table

    there = held(output)
    known, lens = seen.known()
    seen.check(recording, {"--panel-imu": panel_imu, "--base-imu": base_imu})
    notes: list[str] = []
    if recording is not None:
        views, times, imus, lens, notes = read_session(recording, panel_topic, base_topic, lens)
        panels, bases = ([imu] * len(views) for imu in imus)
    else:
        views, times = seen.views(), []
        panels = [read_imu_table(path, "panel") for path in panel_imu or []]
        bases = [read_imu_table(path, "base") for path in base_imu or []]
        for own, base, path in zip(panels, bases, panel_imu or [], strict=True):
            with error_prefix(f"{path} and the base IMU's file of that pose"):
                times.append(common_time(own, base))
    assert lens is not None
    with pictured(output.with_name(f"{output.stem}.seen.png")):
        calibration = calibrate_world_from_views(views, times, panels, bases, known, lens, there)
    out.finish(output, world_answer(calibration), "Camera from base IMU, by the panel", notes)


_SOUND_CLOCKS = "Of sound and event time.  [default: camera,base, or the node with `base` in its name]"


def clock(
    which: Which,
    settings: ConfigInput,
    out: CalibrationOut,
    sound: Annotated[
        o.File, o.value("BEEP.wav", "The camera's sound: WAV, or MCAP with an audio topic.")
    ] = None,
    event_time: Annotated[
        list[float] | None,
        o.value("T", "When the beep ended on the IMU's clock, s; once for each beep."),
    ] = None,
    broadcast: Annotated[o.File, o.value("TIMES.csv", "Receptions: round,node,t_s.")] = None,
    motion: Annotated[
        o.File, o.value("REC.mcap", "A recording with the arm in motion; no equipment.")
    ] = None,
    known: Annotated[
        o.File, o.value("CAL.toml", "With --motion: calibration with the IMU's mounting."), o.SHARED
    ] = None,
    output: Annotated[
        o.File, o.value("CAL.toml", "Calibration file for the offsets.", "-o", "--output"), o.ADDED_TO
    ] = None,
    session: Annotated[o.Text, o.value("NAME", "Name of the session in the file.")] = None,
    sound_clocks: Annotated[o.Text, o.rare_value("A,B", _SOUND_CLOCKS)] = None,
    motion_clocks: Annotated[
        o.Text, o.rare_value("A,B", "Camera's and IMU's clock [camera, the IMU's name].")
    ] = None,
    audio_topic: Annotated[o.Text, o.rare_value("TOPIC", "The audio, where there are several.")] = None,
    sound_start: Annotated[
        float, o.rare_value("S", "Time of a WAV's first sample on the sound's clock.")
    ] = 0.0,
    tone_hz: Annotated[o.Number, o.rare("The buzzer's tone, where it is known.")] = None,
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

    ends, step_s = event_time or [], 1e-3 * resolution_ms
    sources = [path for path in dict.fromkeys((sound, broadcast, motion)) if path]
    o.refuse(
        {
            "give --sound with --event-time, --broadcast, --motion, or several of them": not sources,
            "--sound and --event-time belong together": (sound is None) != (not ends),
            "--event-time takes seconds on the IMU's clock": not all(map(isfinite, ends)),
        }
    )
    clocks = _two("--sound-clocks", sound_clocks or "camera,base")
    held(output)
    receptions: list[Receptions] = []
    beeps: list[Beep] = []
    moved: MotionClock | None = None
    origin_ns = 0
    notes: list[str] = []
    if broadcast is not None:
        receptions.append(read_broadcast(broadcast, step_s))
        if sound_clocks is None:
            clocks = clocks[0], buzzer_node(receptions[0].node, clocks[1])
    if sound is not None:
        read = read_sound(sound, audio_topic, notes)
        tracks = ((each.samples, each.rate_hz, each.start_s) for each in read)
        with error_prefix(str(sound)):
            beeps = beeps_of_tracks(tracks, tone_hz, sound_start)
            source = f"sound {sound.name}"
            heard = beep_receptions(
                beeps, ends, clocks, distance_m=distance_m, resolution_s=step_s, source=source
            )
        receptions.insert(0, heard)
    if motion is not None:
        recording, given = load_arm(motion, known, **which.chosen)
        names = _two("--motion-clocks", motion_clocks or f"camera,{recording.imu.name.rpartition('/')[2]}")
        moved, origin_ns = clock_from_motion(recording, given, settings.read(), names), recording.origin_ns
        notes += recording.notes
    name = session or ", ".join(path.name for path in sources)
    out.finish(output, clock_answer(name, receptions, beeps, moved, origin_ns), f"Clocks: {name}", notes)


def _two(option: str, text: str) -> tuple[str, str]:
    names = [part.strip() for part in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise typer.BadParameter(f"{option} takes two names such as camera,base, not '{text}'")
    return names[0], names[1]
