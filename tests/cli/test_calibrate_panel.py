"""`unocclude calibrate panel` as users run it: files, recording, report, and every refusal."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from cut_files import cut_before_the_summary
from scipy.spatial.transform import Rotation

from calib.file import read_calibration
from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io.markers import read_positions

LAYOUT = "markers = [[0.0, 0.0], [0.2, 0.0], [0.5, 0.0], [0.0, 0.35]]"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two poses as files and as a recording."""
    folder = tmp_path_factory.mktemp("panel")
    made = ["simulate", "panel", "-o", str(folder / "s"), "--poses", "2", "--seed", "5"]
    assert run([*made, "--mcap", str(folder / "s.mcap")]) == 0
    return folder


def pose(folder: Path, number: int = 1, **other: Path) -> list[str]:
    """The options of a pose."""
    files = {what: folder / "s" / f"pose_0{number}_{what}.png" for what in ("depth", "infrared")}
    files |= {"markers": folder / "s" / f"pose_0{number}_markers.csv", **other}
    return [part for what, path in files.items() for part in (f"--{what}", str(path))]


def known(folder: Path, **other: Path) -> list[str]:
    """Lens and panel."""
    files = {"intrinsics": folder / "s" / "intrinsics.toml", "panel": folder / "s" / "panel.toml", **other}
    return [part for what, path in files.items() for part in (f"--{what}", str(path))]


def check(table: dict, folder: Path, degrees: float, metres: float) -> None:
    truth = tomllib.loads((folder / "s" / "truth.toml").read_text())["camera_from_mocap"]
    turn = Rotation.from_quat(table["rotation"], scalar_first=True).inv() * Rotation.from_quat(
        truth["rotation"], scalar_first=True
    )
    assert np.degrees(turn.magnitude()) < degrees
    assert np.linalg.norm(np.subtract(table["translation"], truth["translation"])) < metres


def test_files_to_calibration_report_and_json(session: Path, tmp_path: Path, capsys):
    output, report, figures = tmp_path / "cal.toml", tmp_path / "panel.html", tmp_path / "panel.json"
    output.write_text('format = "unocclude calibration"\nversion = 1\n[other]\nkept = 1\n')
    options = [*pose(session, 1), *pose(session, 2), *known(session), "-o", str(output)]
    command = ["calibrate", "panel", *options, "--report", str(report), "--json", str(figures)]
    assert run(command) == 0
    said = capsys.readouterr().out
    assert "verdict: Rotation within" in said and "next: Record 4 to 8 poses" in said
    tables = read_calibration(output).tables
    table = tables["camera_from_mocap"]
    assert tables["other"] == {"kept": 1}
    check(table, session, 0.15, 0.004)  # the mocap's origin is metres away
    assert table["poses"] == 2 and len(table["residuals"]) == 2 and table["grade"] == "good"
    assert np.shape(table["covariance"]) == (6, 6)
    sigma = np.sqrt(np.diag(table["covariance"]))
    np.testing.assert_allclose(np.degrees(sigma[:3]), table["rotation_sigma_deg"])
    np.testing.assert_allclose(sigma[3:], table["translation_sigma_m"])
    check(table["published"], session, 0.6, 0.02)
    written = json.loads(figures.read_text())
    assert written["camera_from_mocap"]["rotation"] == table["rotation"]
    assert written["words"]["grade"] == "good"
    page = report.read_text()
    for part in (
        "What to record next",
        "The panel in space",
        "data:image/png;base64",
        "Where the markers miss",
    ):
        assert part in page
    assert run(command) == 1  # report and JSON exist


def test_a_recording_gives_the_same(session: Path, tmp_path: Path):
    output, files = tmp_path / "a.toml", tmp_path / "b.toml"
    panel = known(session)[2:]
    assert run(["calibrate", "panel", str(session / "s.mcap"), *panel, "-o", str(output)]) == 0
    assert (
        run(["calibrate", "panel", *pose(session, 1), *pose(session, 2), *known(session), "-o", str(files)])
        == 0
    )
    one, other = (read_calibration(path).tables["camera_from_mocap"] for path in (output, files))
    # CSV has whole micrometres
    np.testing.assert_allclose(one["rotation"], other["rotation"], atol=1e-5)
    np.testing.assert_allclose(one["translation"], other["translation"], atol=3e-5)
    cut = tmp_path / "cut.mcap"
    cut_before_the_summary(session / "s.mcap", cut)
    json_file = tmp_path / "c.json"
    command = [
        "calibrate",
        "panel",
        str(cut),
        *panel,
        "-o",
        str(tmp_path / "c.toml"),
        "--json",
        str(json_file),
    ]
    assert run(command) == 0
    assert "ends in the middle" in json.loads(json_file.read_text())["notes"][0]


def test_infrared_of_8_bits(session: Path, tmp_path: Path):
    infrared = tmp_path / "i.png"
    image = cv2.imread(str(session / "s" / "pose_01_infrared.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(infrared), (image // 256).astype(np.uint8))
    output = tmp_path / "cal.toml"
    options = [*pose(session, infrared=infrared), *known(session), "-o", str(output)]
    assert run(["calibrate", "panel", *options]) == 0
    check(read_calibration(output).tables["camera_from_mocap"], session, 0.2, 0.006)


def edited(source: Path, target: Path, *changes: tuple[str, str]) -> Path:
    text = source.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    target.write_text(text)
    return target


def refused(options: list[str], folder: Path, capsys, *words: str, picture: bool = False) -> None:
    """One sentence on stderr, exit code 1, and nothing written but the picture that it names."""
    output = folder / "out" / "cal.toml"
    output.parent.mkdir()
    assert run(["calibrate", "panel", *options, "-o", str(output)]) == 1
    error = capsys.readouterr().err.strip()
    assert error.startswith("unocclude: ") and "\n" not in error and "unexpected" not in error
    for word in words:
        assert word in error, error
    left = [path.name for path in output.parent.iterdir()]
    assert left == (["cal.seen.png"] if picture else [])
    if picture:
        assert "cal.seen.png" in error
        assert cv2.imread(str(output.parent / "cal.seen.png")).shape[1] >= 1000


def test_mirrored_definition(session: Path, tmp_path: Path, capsys):
    panel = edited(
        session / "s" / "panel.toml",
        tmp_path / "p.toml",
        ("0.35]", "-0.35]"),
        ("[[-0.05, -0.05], [0.55, 0.4]]", "[[-0.05, -0.40], [0.55, 0.05]]"),
    )
    refused([*pose(session), *known(session, panel=panel)], tmp_path, capsys, "mirror image")


def test_wrong_size_of_the_intrinsics(session: Path, tmp_path: Path, capsys):
    lens = edited(session / "s" / "intrinsics.toml", tmp_path / "k.toml", ("width = 512", "width = 640"))
    refused([*pose(session), *known(session, intrinsics=lens)], tmp_path, capsys, "512 x 424", "640 x 424")


def covered(session: Path, target: Path, pixel: np.ndarray) -> Path:
    """The infrared image with a marker painted over in the panel's own shade."""
    image = cv2.imread(str(session / "s" / "pose_01_infrared.png"), cv2.IMREAD_UNCHANGED)
    x, y = np.rint(pixel).astype(int)
    shade = int(np.median(image[y - 15 : y + 15, x - 15 : x + 15]))
    cv2.circle(image, (int(x), int(y)), 7, shade, -1)
    cv2.imwrite(str(target), image)
    return target


def marker_pixels(session: Path) -> np.ndarray:
    truth = tomllib.loads((session / "s" / "truth.toml").read_text())
    return np.array(truth["pose"]["01"]["marker_pixels"])


def test_three_spots(session: Path, tmp_path: Path, capsys):
    hidden = covered(session, tmp_path / "i.png", marker_pixels(session)[1])
    options = [*pose(session, infrared=hidden), *known(session)]
    refused(options, tmp_path, capsys, "three bright spots", picture=True)


def test_five_spots_that_make_two_panels(session: Path, tmp_path: Path, capsys):
    """Markers 1 to 3 alike about the middle one, and a fifth that makes the panel turned by 180 degrees."""
    config = tmp_path / "p.toml"
    config.write_text(
        "[panel]\nmarkers = [[0.0, 0.0], [0.2, 0.0], [0.4, 0.0], [0.0, 0.25]]\n"
        "extent = [[-0.05, -0.3], [0.45, 0.3]]\n"
    )
    made = ["simulate", "panel", "-o", str(tmp_path / "s"), "--seed", "2", "--panel", str(config)]
    assert run([*made, "--extra-markers", "0.4,-0.25"]) == 0
    options = [*pose(tmp_path), *known(tmp_path)]
    refused(options, tmp_path, capsys, "more than one way", picture=True)


def test_no_depth_under_the_panel(session: Path, tmp_path: Path, capsys):
    depth = cv2.imread(str(session / "s" / "pose_01_depth.png"), cv2.IMREAD_UNCHANGED)
    x, y = marker_pixels(session).mean(axis=0).astype(int)
    depth[max(0, y - 150) : y + 150, max(0, x - 150) : x + 150] = 0
    cv2.imwrite(str(tmp_path / "d.png"), depth)
    options = [*pose(session, depth=tmp_path / "d.png"), *known(session)]
    refused(options, tmp_path, capsys, "depth is missing under the panel")


def test_edge_on(tmp_path: Path, capsys):
    assert run(["simulate", "panel", "-o", str(tmp_path / "s"), "--seed", "3", "--tilt-deg", "76,80"]) == 0
    refused([*pose(tmp_path), *known(tmp_path)], tmp_path, capsys, "edge-on")


def test_files_that_are_not_what_they_should_be(session: Path, tmp_path: Path, capsys):
    markers = tmp_path / "m.csv"
    markers.write_text("marker,x,y,z\na,0,0,0\nb,1,0,0\nc,0,1,0\n")
    options = [*pose(session, markers=markers), *known(session)]
    refused(options, tmp_path, capsys, "3 mocap markers")
    (tmp_path / "out").rmdir()
    options = [*pose(session, depth=session / "s" / "panel.toml"), *known(session)]
    refused(options, tmp_path, capsys, "panel.toml", "not an image")
    (tmp_path / "out").rmdir()
    panel = edited(session / "s" / "panel.toml", tmp_path / "p.toml", (", [0.0, 0.35]", ""))
    refused([*pose(session), *known(session, panel=panel)], tmp_path, capsys, "panel.markers")
    (tmp_path / "out").rmdir()
    grey = tmp_path / "g.png"
    cv2.imwrite(str(grey), np.zeros((424, 512), np.uint8))
    refused([*pose(session, depth=grey), *known(session)], tmp_path, capsys, "16 bit")


def test_markers_of_a_file_that_people_make(tmp_path: Path):
    path = tmp_path / "m.csv"
    path.write_bytes(b"\xef\xbb\xbfmarker, x, y ,z, note\r\n C , 1e-1,0.2,-3, x\r\nlost,,,,\r\nA,1,2,3,\r\n")
    found = read_positions(path)
    assert list(found) == ["C", "A"]
    np.testing.assert_allclose(found["C"], [0.1, 0.2, -3])
    path.write_text("marker,x,y,z\na,,,\n")
    with pytest.raises(RecordingError, match="no marker"):
        read_positions(path)


def test_markers_over_time(tmp_path: Path):
    path = tmp_path / "m.trc"

    def write(walk_mm: float) -> None:
        head = [
            "PathFileType\t4\t(X/Y/Z)\tm.trc",
            "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
            "100\t100\t50\t2\tmm\t100\t1\t50",
            "Frame#\tTime\tP1\t\t\tP2\t\t",
            "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
            "",
        ]
        rows = [
            f"{i + 1}\t{i / 100:.2f}\t{100 + (-1) ** i}\t200\t300\t{400 + walk_mm * i}\t500\t600"
            for i in range(50)
        ]
        path.write_text("\n".join([*head, *rows, ""]))

    write(0.0)
    found = read_positions(path)
    np.testing.assert_allclose(found["P1"], [0.1, 0.2, 0.3], atol=1e-9)
    write(1.0)
    with pytest.raises(RecordingError, match="P2 moved by"):
        read_positions(path)
