"""`unocclude calibrate`: of the arm, of sensors, of cameras and panels, of clocks; what all of them share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from . import options as o
from .load import ConfigInput, Which, load_arm, load_arms, refuse_twice
from .output import Out, arms_figures, print_notes, say, say_arm, show

if TYPE_CHECKING:
    from calib.clock import MotionClock, Receptions
    from calib.file import CalibrationFile
    from calib.images import Panel, View
    from calib.intrinsics import Intrinsics
    from calib.protocol import Answer
    from calib.sound import Beep

    from ..calibration import ArmCalibration
    from ..io.recording.choose import Selection
    from ..recording import ImuStream, Recording


def finish(out: Out, output: Path | None, answer: Answer, notes: Iterable[str]) -> None:
    """Write what a calibration found to all outputs, then print it."""
    notes = list(dict.fromkeys(notes))
    out.json({**answer.to_dict(), "notes": notes})
    keep(output, answer)
    print_notes(notes)
    out.end(output)


def held(output: Path | None) -> CalibrationFile:
    """What the file contains already: read before the work, as what cannot be read cannot be added to."""
    from calib.file import CalibrationFile, read_calibration

    return read_calibration(output) if output is not None and output.exists() else CalibrationFile()


def keep(output: Path | None, answer: Answer) -> None:
    """Add an answer to the file; print its figures, verdict, what is open and what to record next."""
    from calib.file import write_calibration

    if output is not None:
        write_calibration(output, answer.table)
    for table in answer.tables():
        show(table)
    say(f"verdict: {answer.sentence}")
    for before, sentences in (
        ("  ", answer.findings),
        ("not determined: ", answer.open_questions),
        ("next: ", answer.next),
    ):
        for sentence in sentences:
            say(f"{before}{sentence}")


@contextmanager
def error_prefix(what: str) -> Iterator[None]:
    """Put the name of what is worked on before the message of an error."""
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"{what}: {error}") from error


def motion(
    files: Annotated[list[Path], o.argument("REC.mcap", "Recordings of one person and one mounting.")],
    output: o.CalibrationOutput,
    which: Which,
    settings: ConfigInput,
    out: Out,
    known: o.Known = None,
) -> None:
    """Lever arms, limb lengths, IMU mounting, from visible motion.

    Several recordings are solved together. An existing calibration file is updated, without --force: the
    arm's values are replaced, everything else is kept. With IMUs on both arms, each arm is calibrated
    separately.

    Example: unocclude calibrate motion a.mcap b.mcap -o arm.toml
    """
    from calib.motion import calibrate_motion, motion_answer

    refuse_twice(files)
    held(output)
    config = settings.read()
    arms = _by_side(files, known, which.chosen)
    answers: list[tuple[Recording, Answer]] = []
    for recordings, given in arms:
        with error_prefix(recordings[0].arm_label) if len(arms) > 1 else nullcontext():
            estimates = calibrate_motion(recordings, given, config)
            if not estimates.calibration.lever_arms:
                raise CalibrationError(
                    "only the strap was tracked, which is the IMU's own place: there is no lever arm to find"
                )
        answers.append((recordings[0], motion_answer(estimates)))
    notes = [note for recordings, _ in arms for recording in recordings for note in recording.notes]
    figures = arms_figures([own for own, _ in answers], [answer.to_dict() for _, answer in answers])
    out.json({**figures, "notes": list(dict.fromkeys(notes))})
    for recording, answer in answers:
        say_arm(recording, len(arms))
        keep(output, answer)
        say("A clock offset belongs to its recording: every recording's is solved anew, never carried over.")
        if answer.figures["R_F_A"] is not None:
            say("R_F_A takes the IMU to sit on the back of the forearm.")
    print_notes(notes)
    out.end(output)


def _by_side(
    files: list[Path], known_file: Path | None, chosen: Selection
) -> list[tuple[list[Recording], ArmCalibration | None]]:
    """The recordings of each arm, with what is known of it; one arm unless recordings have both."""
    loaded = [(path, *arm) for path in files for arm in load_arms(path, known_file, **chosen)]
    sides = {recording.side for _, recording, _ in loaded} - {""}
    for path, recording, _ in loaded:
        if recording.body is not None:
            raise CalibrationError(
                f"{path}: several people wear IMUs, and a calibration is one person's; choose with --body"
            )
        if not recording.side and len(sides) > 1:
            raise CalibrationError(
                f"{path} does not state whether it is the left or the right arm's, and the others are of"
                " both; calibrate it apart"
            )
    arms = [
        [(recording, known) for _, recording, known in loaded if recording.side in (side, "")]
        for side in sorted(sides) or [""]
    ]
    return [([recording for recording, _ in mine], mine[0][1]) for mine in arms]


Sensor = Annotated[o.Text, o.value("TOPIC", "The IMU, where the recording has several.", "--imu")]


def imu(
    recording_file: o.RecordingPath,
    output: o.CalibrationOutput,
    out: Out,
    name: Sensor = None,
    gravity: Annotated[
        float, o.rare_value("M/S^2", "Gravity where it was recorded; `smooth` assumes 9.81.")
    ] = 9.81,
) -> None:
    """An IMU's offsets, scales and noise, from rest poses.

    Lay the sensor still for three seconds on each of its six sides and on six edges between them, in any
    order; rests are found automatically. One long rest (an hour) instead gives the noise.

    Example: unocclude calibrate imu poses.mcap -o arm.toml
    """
    from calib.imu import calibrate_imu, imu_answer

    if not 9.7 <= gravity <= 9.9:
        raise typer.BadParameter("--gravity on Earth is between 9.76 and 9.84 m/s^2")
    stream, notes = _load(recording_file, name, output)
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_imu(stream, gravity)
    finish(out, output, imu_answer(calibration), notes)


def magnetometer(
    recording_file: o.RecordingPath, output: o.CalibrationOutput, out: Out, name: Sensor = None
) -> None:
    """A magnetometer's hard and soft iron.

    Turn the sensor slowly about all its axes for a minute, on one spot and away from iron, until every side
    has pointed in every direction.

    Example: unocclude calibrate magnetometer turning.mcap -o arm.toml
    """
    from calib.imu import calibrate_magnetometer, magnetometer_answer

    stream, notes = _load(recording_file, name, output)
    if stream.mag is None:
        raise CalibrationError(
            f"{recording_file}: {stream.name} has no magnetometer; record its magnetic field as well."
        )
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_magnetometer(stream.mag)
    finish(out, output, magnetometer_answer(calibration, stream.name), notes)


def _load(path: Path, name: str | None, output: Path) -> tuple[ImuStream, list[str]]:
    """The stream to calibrate, and what there is to know of its file."""
    from calib.file import sensors_in

    from ..io.recording.read import read_imu

    sensors_in(held(output))
    stream, notes = read_imu(path, name)
    say(f"{path}: IMU {stream.name}, {stream.rate_hz:.0f} Hz, {stream.t_s[-1] - stream.t_s[0]:.0f} s")
    return stream, notes


def forearm(
    recording_file: o.RecordingPath,
    output: o.CalibrationOutput,
    which: Which,
    settings: ConfigInput,
    out: Out,
    from_s: Annotated[
        o.Number, o.value("S", "Start of the held pose, s on the camera's clock.", "--from")
    ] = None,
    to_s: Annotated[o.Number, o.value("S", "End of the held pose, s.", "--to")] = None,
    radius_m: Annotated[
        o.Number, o.option("Axis of the forearm to the sensor, by ruler.", min=0.005, max=0.15)
    ] = None,
    strap_to_wrist_m: Annotated[
        o.Number, o.option("Strap to the wrist joint, by ruler.", min=-0.1, max=0.3)
    ] = None,
) -> None:
    """Lever arms, lengths, mounting, from a held pose.

    The forearm raised beside the head, palm to the camera, still for a second or more; motion in the same
    recording gives the sensor's orientation to the camera, and is compared with the pose. An existing
    calibration file is updated, without --force.

    Example: unocclude calibrate forearm session.mcap -o arm.toml
    """
    from calib.forearm import calibrate_forearm, forearm_answer

    if (from_s is None) != (to_s is None) or (from_s is not None and to_s is not None and to_s <= from_s):
        raise typer.BadParameter("--from and --to belong together, --to later than --from")
    held(output)
    config = settings.read()
    recording, _ = load_arm(recording_file, **which.chosen)
    calibration = calibrate_forearm(recording, from_s, to_s, radius_m, strap_to_wrist_m, config)
    finish(out, output, forearm_answer(calibration), recording.notes)


def cameras(
    files: Annotated[list[Path], o.argument("REC.mcap..", "Recordings of the set-up.")],
    output: o.CalibrationOutput,
    which: Which,
    out: Out,
) -> None:
    """Poses of further cameras, from joints seen by both.

    `smooth --calibration` uses the poses as priors and reports a camera that was moved since. Clock offsets
    belong to one recording: they are shown and not stored. An existing calibration file is updated.

    Example: unocclude calibrate cameras session.mcap -o cal.toml
    """
    from calib.intrinsics import calibrate_cameras

    held(output)
    recordings = [load_arm(path, **which.chosen)[0] for path in files]
    notes = [note for recording in recordings for note in recording.notes]
    finish(out, output, calibrate_cameras(recordings), notes)


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
    out: Out,
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
    finish(out, output, panel_answer(calibration), notes)


def world(
    output: o.CalibrationOutput,
    out: Out,
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
    finish(out, output, world_answer(calibration), notes)


_SOUND_CLOCKS = "Of sound and event time.  [default: camera,base, or the node with `base` in its name]"


def clock(
    which: Which,
    settings: ConfigInput,
    out: Out,
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
    finish(out, output, clock_answer(name, receptions, beeps, moved, origin_ns), notes)


def _two(option: str, text: str) -> tuple[str, str]:
    names = [part.strip() for part in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise typer.BadParameter(f"{option} takes two names such as camera,base, not '{text}'")
    return names[0], names[1]
