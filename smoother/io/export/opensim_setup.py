"""A folder that OpenSim runs as it is: model, markers, angles, orientations, and the set-ups of its tools."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...linalg import runs
from ...result import Recovery
from ...runtime.outputs import writing
from .markers import MarkerTable, marker_table, write_trc
from .osim import GENERIC, arm_measures, osim_text
from .prepare import level_note
from .storage import mot_table, orientation_table, write_mot, write_sto

#: Files of the folder. The last two are missing without orientations of forearm and upper arm.
MODEL, GENERIC_MODEL, SCALED_MODEL = "arm.osim", "generic.osim", "scaled.osim"
MARKERS, ANGLES, ORIENTATIONS = "arm.trc", "arm.mot", "arm.sto"
SCALE, IK, IMU_IK = "scale.xml", "ik.xml", "imu_ik.xml"
#: Of the markers' fit; the tools' own 1e-5 stops degrees short in pro_sup, by a marker 3 cm off the bone.
ACCURACY = 1e-9
#: The pose in which Scale places markers is the mean over this time, s.
POSE_S = 0.5
#: A marker that is always there, where the camera is: Inverse Kinematics divides by the weight of the markers
#: of a row, and ends where all of them are blank (tried with OpenSim 4.6).
ANCHOR = "camera"
_JOINTS = ("shoulder", "elbow", "wrist")
#: Measurements of Scale: its two markers, and the bodies that it stretches.
_MEASUREMENTS = {
    "upper_arm": ("shoulder elbow", ("humerus",)),
    "forearm": ("elbow wrist", ("ulna", "radius")),
}


def opensim_files(
    recovery: Recovery, rate_hz: float | None = None, level_down: FloatArray | None = None
) -> tuple[dict[str, Callable[[Path], None]], tuple[str, ...]]:
    """What writes each file of the folder, by its name, and what a reader must know.

    Parameters
    ----------
    recovery : Recovery
        One arm, with shoulder, elbow and wrist.
    rate_hz : float, optional
        Rows per second of markers and angles; None for the IMU's rate.
    level_down : ndarray, shape (3,), optional
        See `marker_table`.

    Returns
    -------
    files : dict of str to callable
        Each takes the path to write.
    notes : tuple of str
        One sentence each.

    Raises
    ------
    UnoccludeError
        A joint is missing, or shoulder, elbow and wrist are never there together for half a second.
    """
    measures = arm_measures(recovery)
    markers = marker_table(recovery, "opensim", rate_hz, level_down)
    angles = mot_table(recovery, rate_hz)
    t_s, names = markers.grid.t_s, [name for name in (*_JOINTS, "hand", "imu") if name in markers.names]
    known, pose = _times(recovery.name, markers)
    side = measures.side or "right"
    # Scale turns the forearm as the angles say, so that it finds where the hand's markers are
    turned = ("pro_sup",) if "pro_sup" in angles.angles else ()
    placed = [name for name in names if name in measures.places]
    # Scale would place every marker that it may move, also one that this arm's model does not have
    adult = replace(
        GENERIC,
        side=side,
        places={name: place for name, place in GENERIC.places.items() if name in placed},
        turns=measures.turns,
    )
    texts = {
        MODEL: osim_text(measures, f"{side}_arm", camera=True),
        GENERIC_MODEL: osim_text(adult, f"generic_{side}_arm", placed, camera=True),
        SCALE: scale_text(known, pose, placed, turned),
        IK: ik_text((float(t_s[0]), float(t_s[-1])), [*_JOINTS, *placed, ANCHOR]),
    }
    position = np.concatenate([markers.position, np.zeros((len(t_s), 1, 3))], axis=1)
    columns = (*markers.names, ANCHOR)
    files: dict[str, Callable[[Path], None]] = {
        MARKERS: lambda path: write_trc(path, columns, t_s, position, markers.grid.rate_hz, True),
        ANGLES: lambda path: write_mot(angles, path, recovery, True),
    }
    notes = list(level_note(recovery))
    notes += [f"{ANGLES}: {note}" for note in angles.notes]
    if {"radius", "humerus"} <= measures.imus.keys():
        table = orientation_table(recovery, level_down)
        files[ORIENTATIONS] = lambda path: write_sto(table, path, True)
        texts[IMU_IK] = imu_ik_text((float(table.t_s[0]), float(table.t_s[-1])), list(table.quaternion))
        notes += [f"{ORIENTATIONS}: {note}" for note in table.notes]
    else:
        notes.append(
            f"no {ORIENTATIONS} and no {IMU_IK}: OpenSense needs IMUs on forearm and upper arm whose mounting"
            " is known; Inverse Kinematics takes the markers."
        )
    return files | {name: partial(_text, text) for name, text in texts.items()}, tuple(notes)


def write_opensim(
    files: Mapping[str, Callable[[Path], None]], folder: str | Path, force: bool = False
) -> None:
    """Write the folder.

    Parameters
    ----------
    files : mapping of str to callable
        As `opensim_files` gives them.
    folder : path-like
        Made where it is missing.
    force : bool
        Overwrite files that exist.

    Raises
    ------
    UnoccludeError
        A file exists and `force` is not given, or one cannot be written.
    """
    folder = Path(folder)
    check_opensim_folder(folder, force)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnoccludeError(f"{folder}: {error.strerror or error}; give another folder") from error
    for name, write in files.items():
        write(folder / name)


def check_opensim_folder(folder: Path, force: bool) -> None:
    """Refuse a folder that contains something already, and a file in its place.

    Raises
    ------
    UnoccludeError
    """
    if folder.exists() and not folder.is_dir():
        raise UnoccludeError(f"{folder} is a file; what is written for OpenSim is a folder")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise UnoccludeError(f"{folder} is not empty; give another folder, or --force")


def _times(name: str, markers: MarkerTable) -> tuple[tuple[float, float], tuple[float, float]]:
    """The longest time in which no joint is blank, and the stillest `POSE_S` of it, s.

    Scale leaves a measurement out without a word of error where a marker of it is blank in its time.
    """
    t_s, step = markers.grid.t_s, max(round(POSE_S * markers.grid.rate_hz), 2)
    places = np.stack([markers.position[:, markers.names.index(joint)] for joint in _JOINTS])
    whole: BoolArray = np.asarray(np.isfinite(places).all(axis=(0, 2)))
    longest = max(runs(whole), key=lambda run: run.stop - run.start, default=slice(0, 0))
    if longest.stop - longest.start <= step:
        raise UnoccludeError(
            f"{name}: shoulder, elbow and wrist are never all there for {POSE_S:g} s, which OpenSim's Scale"
            " needs; export to trc, csv or parquet"
        )
    wrist = places[2, longest]
    moved = np.linalg.norm(np.diff(wrist, axis=0), axis=1)
    path = np.convolve(moved, np.ones(step - 1), "valid")
    first = longest.start + int(np.argmin(path))
    return (
        (float(t_s[longest.start]), float(t_s[longest.stop - 1])),
        (float(t_s[first]), float(t_s[first + step - 1])),
    )


def _text(text: str, path: Path) -> None:
    with writing(path, True) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def scale_text(
    known: tuple[float, float], pose: tuple[float, float], placed: Sequence[str], turned: Sequence[str]
) -> str:
    """The set-up of OpenSim's Scale: lengths by the joints, then the other markers' places in a still pose.

    Parameters
    ----------
    known : (float, float), s
        In which all joints are there.
    pose : (float, float), s
        In which the markers are placed.
    placed : sequence of str
        Markers to place.
    turned : sequence of str
        Coordinates that the pose takes from the angles.
    """
    measured = "".join(
        f'<Measurement name="{name}"><apply>true</apply><MarkerPairSet><objects><MarkerPair><markers>{pair}'
        "</markers></MarkerPair></objects></MarkerPairSet><BodyScaleSet><objects>"
        + "".join(f'<BodyScale name="{body}"><axes>X Y Z</axes></BodyScale>' for body in bodies)
        + "</objects></BodyScaleSet></Measurement>\n"
        for name, (pair, bodies) in _MEASUREMENTS.items()
    )
    tasks = [_marker_task(name) for name in _JOINTS]
    tasks += [_marker_task(name, apply=False) for name in placed]
    tasks += [
        f'<IKCoordinateTask name="{name}"><apply>true</apply><weight>1000</weight>'
        "<value_type>from_file</value_type></IKCoordinateTask>\n"
        for name in turned
    ]
    angles = f"<coordinate_file>{ANGLES}</coordinate_file>\n" if turned else ""
    return _document(
        '<ScaleTool name="arm">\n<mass>-1</mass>\n'
        f"<GenericModelMaker><model_file>{GENERIC_MODEL}</model_file></GenericModelMaker>\n"
        "<ModelScaler>\n<scaling_order>measurements</scaling_order>\n"
        f'<MeasurementSet name="lengths"><objects>\n{measured}</objects></MeasurementSet>\n'
        f"<marker_file>{MARKERS}</marker_file>\n<time_range>{_span(known)}</time_range>\n"
        "<preserve_mass_distribution>false</preserve_mass_distribution>\n"
        f"<output_model_file>{SCALED_MODEL}</output_model_file>\n</ModelScaler>\n"
        f"<MarkerPlacer>\n<IKTaskSet><objects>\n{''.join(tasks)}</objects></IKTaskSet>\n"
        f"<marker_file>{MARKERS}</marker_file>\n{angles}<time_range>{_span(pose)}</time_range>\n"
        f"<output_model_file>{SCALED_MODEL}</output_model_file>\n</MarkerPlacer>\n</ScaleTool>\n"
    )


def ik_text(span: tuple[float, float], markers: Sequence[str]) -> str:
    """The set-up of OpenSim's Inverse Kinematics, from markers to `ik.mot`.

    Parameters
    ----------
    span : (float, float), s
        From the first row to the last.
    markers : sequence of str
        Of the model; blank ones are passed over row by row.
    """
    tasks = "".join(_marker_task(name) for name in markers)
    return _document(
        '<InverseKinematicsTool name="ik">\n<results_directory>.</results_directory>\n'
        f"<model_file>{MODEL}</model_file>\n<marker_file>{MARKERS}</marker_file>\n"
        f"<IKTaskSet><objects>\n{tasks}</objects></IKTaskSet>\n<accuracy>{ACCURACY:g}</accuracy>\n"
        f"<time_range>{_span(span)}</time_range>\n<report_errors>true</report_errors>\n"
        "<output_motion_file>ik.mot</output_motion_file>\n</InverseKinematicsTool>\n"
    )


def imu_ik_text(span: tuple[float, float], imus: Sequence[str]) -> str:
    """The set-up of OpenSense's inverse kinematics, from orientations to `imu_ik.mot`.

    Parameters
    ----------
    span : (float, float), s
        From the first row to the last.
    imus : sequence of str
        Columns of the orientations; those that the model has no frame of are passed over.
    """
    weights = "".join(
        f'<OrientationWeight name="{name}"><weight>1</weight></OrientationWeight>\n' for name in imus
    )
    return _document(
        '<IMUInverseKinematicsTool name="imu_ik">\n<results_directory>.</results_directory>\n'
        f"<model_file>{MODEL}</model_file>\n<orientations_file>{ORIENTATIONS}</orientations_file>\n"
        # y is up already, and the heading is the camera's
        "<sensor_to_opensim_rotations>0 0 0</sensor_to_opensim_rotations>\n"
        f'<OrientationWeightSet name="orientation_weights"><objects>\n{weights}'
        "</objects></OrientationWeightSet>\n"
        f"<accuracy>{ACCURACY:g}</accuracy>\n<time_range>{_span(span)}</time_range>\n"
        "<report_errors>true</report_errors>\n<output_motion_file>imu_ik.mot</output_motion_file>\n"
        "</IMUInverseKinematicsTool>\n"
    )


def _document(content: str) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40000">\n'
        f"{content}</OpenSimDocument>\n"
    )


def _marker_task(name: str, apply: bool = True) -> str:
    return (
        f'<IKMarkerTask name="{name}"><apply>{str(apply).lower()}</apply><weight>1</weight></IKMarkerTask>\n'
    )


def _span(times: tuple[float, float]) -> str:
    return f"{times[0]:.9f} {times[1]:.9f}"
