"""Tables in German, French and Spanish, without header, and files that a device's own importer refuses."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from imu_files import GRAVITY, motion

from smoother.errors import RecordingError
from smoother.io.files import ImuFiles, import_files
from smoother.io.registry import FileReader, recognise
from smoother.io.tables.imu import ImuTable
from smoother.io.tables.joints import joint_name
from smoother.io.tables.skeletons import SkeletonTable
from smoother.io.tables.table import read_head

COUNT = 400
ACC, GYRO = motion(COUNT)
T_S = np.arange(COUNT) * 0.01


def written(path: Path, heads: list[str], columns: list[np.ndarray], mark: str = ",") -> Path:
    """A table with semicolons and a decimal mark."""
    rows = [
        ";".join(f"{value:.9g}".replace(".", mark) for value in row) for row in zip(*columns, strict=True)
    ]
    path.write_text("\n".join([";".join(heads)] * bool(heads) + rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("time", "force", "turn"),
    [
        ("Zeitstempel (ms)", "Beschleunigung {} [g]", "Drehrate {} [°/s]"),
        ("Temps (ms)", "Accélération {} (g)", "Vitesse angulaire {} (deg/s)"),
        ("Tiempo (ms)", "Aceleración {} (g)", "Velocidad angular {} (°/s)"),
        ("Zeit [ms]", "Beschleunigungssensor {} [g]", "Gyroskop {} [deg/s]"),
    ],
)
def test_names_of_axes_in_other_languages(tmp_path: Path, time: str, force: str, turn: str):
    heads = [time, *(force.format(a) for a in "xyz"), *(turn.format(a) for a in "xyz")]
    path = written(tmp_path / "a.csv", heads, [1000 * T_S, *(ACC / GRAVITY).T, *np.degrees(GYRO).T])
    reader = FileReader()
    (table,) = reader.read(path, reader.format_of(path, "imu"))
    assert isinstance(table, ImuTable) and table.acc is not None and table.gyro is not None
    assert np.allclose(table.acc, ACC, atol=1e-5) and np.allclose(table.gyro, GYRO, atol=1e-6)
    assert table.t_s is not None and np.allclose(table.t_s - table.t_s[0], T_S)


@pytest.mark.parametrize(
    ("time", "joints"),
    [
        ("Zeit (s)", ("Schulter rechts {} [mm]", "Ellenbogen rechts {} [mm]", "Handgelenk rechts {} [mm]")),
        ("Temps (s)", ("Épaule droite {} [mm]", "Coude droit {} [mm]", "Poignet droit {} [mm]")),
        ("Tiempo (s)", ("Hombro derecho {} [mm]", "Codo derecho {} [mm]", "Muñeca derecha {} [mm]")),
    ],
)
def test_names_of_joints_in_other_languages(tmp_path: Path, time: str, joints: tuple[str, ...]):
    places = np.cumsum([[0.1, 0.2, 2.0], [0.0, -0.3, 0.0], [0.05, -0.25, -0.05]], axis=0)
    moved = places[:, None] + 0.05 * np.sin(T_S[:90])[:, None]
    heads = [time, *(joint.format(axis) for joint in joints for axis in "XYZ")]
    columns = [T_S[:90] * 3.3, *(1000 * values for joint in moved for values in joint.T)]
    path = written(tmp_path / "a.csv", heads, columns)
    reader = FileReader()
    (table,) = reader.read(path, reader.format_of(path, "skeleton"))
    assert isinstance(table, SkeletonTable)
    for name, values in zip(("shoulder_right", "elbow_right", "wrist_right"), moved, strict=True):
        assert np.allclose(table.position[name], values, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        ("HandgelenkLinks", "wrist_left"),
        ("linkes_Handgelenk", "wrist_left"),
        ("mano izquierda", "hand_left"),
        ("main_gauche", "hand_left"),
        ("ÉPAULE_DROITE", "shoulder_right"),
        ("Handgelenk", ""),
        ("Gelenk rechts", ""),
    ],
)
def test_joints_by_their_translated_names(name: str, joint: str):
    meaning = joint_name(name)
    assert ("" if meaning is None else meaning.joint) == joint


def watch(path: Path, values: np.ndarray, late: int = 0) -> Path:
    """`date,x,y,z` as a watch writes it: no header, some stamps repeat or go back."""
    stamps = 1_773_300_000_000 + (1000 * T_S).astype(int)
    stamps[50], stamps[120], stamps[300] = stamps[49], stamps[119] - 5, stamps[299]
    dates = [f"{datetime.fromtimestamp(stamp / 1e3, UTC):%Y-%m-%d %H:%M:%S.%f}" for stamp in stamps]
    rows = zip(dates[late:], values[late:], strict=True)
    lines = [",".join([date, *(f"{value:.6f}" for value in row)]) for date, row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_dates_and_three_numbers_in_two_files_that_start_apart(tmp_path: Path):
    acc = watch(tmp_path / "a.csv", ACC)
    gyro = watch(tmp_path / "g.csv", np.degrees(GYRO), late=70)
    file, (first, second) = import_files([], [ImuFiles((acc, gyro), "forearm_right")])
    (imu,) = file.imus
    assert (imu.stamp_ns[0] - 1_773_300_000_000_000_000) / 1e9 == pytest.approx(0.7, abs=0.02)
    at = np.searchsorted(T_S, (imu.stamp_ns - 1_773_300_000_000_000_000) / 1e9 - 0.004)
    assert np.median(np.abs(imu.acc - ACC[at])) < 1e-3
    assert np.median(np.abs(imu.gyro - GYRO[at])) < 1e-3
    said = " ".join([*first.notes, *second.notes])
    assert "assumed a gyroscope" in said and "repeat or go back" in said


def test_a_table_that_looks_like_a_device_and_is_read_by_its_columns(tmp_path: Path):
    heads = ["t_ms", *(f"acc_{a}" for a in "xyz"), *(f"gyro_{a}" for a in "xyz")]
    path = written(tmp_path / "a.csv", heads, [1000 * T_S, *(ACC / GRAVITY).T, *np.degrees(GYRO).T], ".")
    reader = FileReader()
    (table,) = reader.read(path, reader.format_of(path, "imu"))
    assert isinstance(table, ImuTable) and table.acc is not None
    assert np.allclose(table.acc, ACC, atol=1e-5)
    assert "as NilsPod CSV it cannot be" in table.notes[-1]
    with pytest.raises(RecordingError, match=r"NilsPod CSV.* is without both"):
        named = FileReader(imu_format="nilspod")
        named.read(path, named.format_of(path, "imu"))


def test_what_is_not_known_is_not_made_up(tmp_path: Path):
    heads = [*(f"K {a} [m/s^2]" for a in "xyz"), *(f"D {a} [rad/s]" for a in "xyz")]
    good = written(tmp_path / "c.csv", ["t_s", *heads], [T_S, *ACC.T, *GYRO.T], ".")
    known = recognise(read_head(good))
    assert known is not None and known.key == "android"
    for name, columns, said in (
        (heads, [*ACC.T, *GYRO.T], "no column of times"),
        (["t_s", *heads], [T_S, *(0.01 * ACC).T, *GYRO.T], "without gravity"),
    ):
        path = written(tmp_path / "a.csv", name, columns, ".")
        importer = recognise(read_head(path))
        assert importer is not None
        with pytest.raises(RecordingError, match=said):
            importer.read(path)
