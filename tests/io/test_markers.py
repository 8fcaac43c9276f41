"""Marker files: what programs write, what is missing in them, and real ones."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import skeleton_files as made

from smoother.errors import RecordingError
from smoother.io.tables.markers import _refuse_cut_off, read_markers

DATASETS = os.environ.get("UNOCCLUDE_DATASETS")

#: Frames, markers, stated rate, share of places seen (percent) of the real files at hand.
REAL = {
    "kineticstoolkit/sample_OptiTrack_walking.c3d": (3361, 12, 160.0, 92.6),
    "kineticstoolkit/sample_probing_ulnar_styloid_R.c3d": (140, 41, 69.5, 100.0),
    "kineticstoolkit/sample_static.c3d": (700, 41, 69.9, 79.5),
    "opensim-core/dataWithBlanksForMissingMarkers.trc": (464, 40, 250.0, 19.2),
    "opensim-core/dataWithNaNsOfDifferentCases.trc": (5, 14, 250.0, 92.9),
    "opensim-core/dataWithNaNsWithSpaces.trc": (427, 42, 100.0, 99.9),
    "opensim-core/gait10dof18musc_walk_CRLF_line_ending.trc": (10, 41, 60.0, 100.0),
    "opensim-core/test_walking.c3d": (806, 40, 250.0, 67.6),
    "opensim-core/test_walking.trc": (806, 40, 250.0, 67.6),
    "opensim-core/walking2.c3d": (1249, 44, 250.0, 49.8),
}

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\tmade.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t{frames}\t2\t{unit}\t100\t1\t{frames}\n"
    "Frame#\tTime\tA\t\t\tB\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)


def write(folder: Path, rows: str, unit: str = "mm", change=lambda text: text) -> Path:
    path = folder / "made.trc"
    text = HEAD.format(frames=len(rows.splitlines()), unit=unit) + "\n" + rows
    path.write_bytes(change(text).encode())
    return path


class TestTrc:
    ROWS = "1\t0.00\t1\t2\t3\t4\t5\t6\n2\t0.01\t10\t20\t30\t40\t50\t60\n"

    @pytest.mark.parametrize(
        "change",
        [
            lambda text: text.replace("\n", "\r\n"),
            lambda text: text.replace("\t", ","),
            lambda text: "\ufeff" + text,
            lambda text: text.replace("10\t20\t30", "1.0E+01\t2e1\t3.0d+01"),
            lambda text: text.replace("10\t20\t30", "10,0\t20,0\t 30 "),
            lambda text: text.replace("60\n", "60\t\t\n\n\n"),
            lambda text: text.replace("\tA\t\t\tB\t\t", "\t\tA\t\tB"),  # names over the wrong columns
            lambda text: text.replace("\tX1\tY1\tZ1\tX2\tY2\tZ2\n", "\tX1\tY1\tZ1\tX2\tY2\tZ2\t\n \n"),
            lambda text: text.replace("\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n", ""),
            lambda text: text.replace("2\tmm", "7\tmm"),  # a wrong number of markers
            lambda text: text.replace("\tmm\t", "\t MM \t"),
            lambda text: (
                text.replace("\tmm\t", "\tcm\t")
                .replace("1\t2\t3\t4\t5\t6", ".1\t.2\t.3\t.4\t.5\t.6")
                .replace("10\t20\t30\t40\t50\t60", "1\t2\t3\t4\t5\t6")
            ),
            lambda text: (
                text[: text.index("Frame#")]
                + text[text.index("Frame#") :].replace("\t\t", " ").replace("\t", " ")
            ),
        ],
        ids=[
            *("crlf", "commas", "bom", "exponents", "decimal-commas", "blanks"),
            *("shifted", "row", "no-axes", "count", "capitals", "cm", "spaces"),
        ],
    )
    def test_habits_of_programs(self, tmp_path, change):
        found = read_markers(write(tmp_path, self.ROWS, change=change))
        assert found.names == ("A", "B") and found.rate_hz == 100 and found.t_s.tolist() == [0, 0.01]
        np.testing.assert_allclose(found.position[1] * 1000, [[10, 20, 30], [40, 50, 60]])
        np.testing.assert_allclose(found.position[0] * 1000, [[1, 2, 3], [4, 5, 6]])

    @pytest.mark.parametrize(
        "cell",
        ["", "nan", "NaN", "NAN", "  Nan ", "-nan(ind)", "-1.#IND", "1.#QNAN", "#N/A", "NULL", "inf", "-"],
    )
    def test_every_spelling_of_nothing(self, tmp_path, cell):
        found = read_markers(
            write(tmp_path, f"1\t0\t{cell}\t{cell}\t{cell}\t4\t5\t6\n2\t0.01\t1\t{cell}\t3\t0\t0\t0\n")
        )
        assert np.isnan(found.position[0, 0]).all()
        assert np.isnan(found.position[1, 0]).all()  # a marker is seen with all three coordinates or not
        np.testing.assert_allclose(found.position[0, 1], [0.004, 0.005, 0.006])
        assert np.isnan(found.position[1, 1]).all()  # the origin stands for a lost marker

    def test_lines_that_stop_early(self, tmp_path):
        found = read_markers(write(tmp_path, "1\t0\t1\t2\t3\n2\t0.01\t1\t2\t3\t4\t5\t6\n"))
        assert np.isnan(found.position[0, 1]).all() and np.isfinite(found.position[1, 1]).all()
        rows = "".join(f"{k + 1}\t{k / 100}\t1\t2\t3\t4\t5\t6\n" for k in range(20))
        found = read_markers(write(tmp_path, rows, change=lambda text: text[:-24]))  # it was cut off
        assert len(found) == 18 and "counts 20 frames and the file contains 18" in " ".join(found.notes)

    def test_times_and_the_stated_rate(self, tmp_path):
        rows = "".join(f"{k + 1}\t{k / 120:.3f}\t1\t2\t3\t4\t5\t{k + 1}\n" for k in range(60))
        found = read_markers(write(tmp_path, rows, change=lambda text: text.replace("\n100\t", "\n120\t")))
        np.testing.assert_allclose(np.diff(found.t_s), 1 / 120, atol=1e-12)  # they were rounded
        assert found.t_s[0] == pytest.approx(0, abs=2e-4) and not found.notes
        rows = "".join(f"{k + 1}\t{k / 25}\t1\t2\t3\t4\t5\t6\n" for k in range(20))
        found = read_markers(write(tmp_path, rows))  # of another rate
        np.testing.assert_allclose(found.t_s, np.arange(20) / 25)
        assert "25 Hz" in found.notes[0]

    @pytest.mark.parametrize(
        ("rows", "said"),
        [
            ("", "no frame"),
            ("1\t0\tone\t2\t3\t4\t5\t6\n", "line 7: 'one' in column 3 is not a number"),
            ("1\t0\t1\t2\t3\t4\t5\t6\t7\t8\t9\n", "line 7: 11 cells where there are 8"),
            ("1\t0.1\t1\t2\t3\t4\t5\t6\n2\t0\t1\t2\t3\t4\t5\t6\n", "time does not increase"),
        ],
    )
    def test_refused_with_the_reason(self, tmp_path, rows, said):
        with pytest.raises(RecordingError, match=said):
            read_markers(write(tmp_path, rows))

    @pytest.mark.parametrize(
        ("name", "unit", "first", "said"),
        [
            ("made.trc", "mm", "Row", "no line begins with Frame#"),
            ("made.trc", "furlong", "Frame#", "unit of length is 'furlong'"),
            ("made.trc", "", "Frame#", "states no Units"),
            ("none.trc", "mm", "Frame#", "there is no such file"),
            ("none.xlsx", "mm", "Frame#", r"read from \.c3d or \.trc"),
        ],
    )
    def test_refused_headers(self, tmp_path, name, unit, first, said):
        write(tmp_path, self.ROWS, unit, lambda text: text.replace("Frame#", first))
        with pytest.raises(RecordingError, match=said):
            read_markers(tmp_path / name)


class TestC3d:
    def test_unit_time_names_and_missing(self, tmp_path):
        rng = np.random.default_rng(0)
        position = rng.uniform(100, 900, (20, 3, 3))
        position[4, 1] = np.nan
        position[5, 2] = 0.0
        found = read_markers(made.c3d(tmp_path / "a.c3d", position, labels=["A ", " B", "C"], rate=120.0))
        assert found.names == ("A", "B", "C")
        np.testing.assert_allclose(found.t_s, np.arange(20) / 120, atol=1e-9)
        assert np.isnan(found.position[4, 1]).all()
        assert np.isnan(found.position[5, 2]).all()
        assert np.isfinite(found.position).all(axis=2).sum() == 58
        np.testing.assert_allclose(found.position[3], position[3] / 1000, rtol=1e-6)  # single precision
        in_metres = read_markers(made.c3d(tmp_path / "b.c3d", position / 1000, unit="m"))
        np.testing.assert_allclose(in_metres.position[3], position[3] / 1000, rtol=1e-6)

    def test_names_go_on_beyond_255(self, tmp_path):
        position = np.random.default_rng(1).uniform(1, 2, (4, 300, 3))
        found = read_markers(made.c3d(tmp_path / "a.c3d", position))
        assert found.names == tuple(f"M{k}" for k in range(300))
        np.testing.assert_allclose(found.position[:, 299], position[:, 299] / 1000, rtol=1e-6)

    def test_points_without_names_and_with_the_same(self, tmp_path):
        position = np.ones((4, 3, 3))
        found = read_markers(made.c3d(tmp_path / "a.c3d", position, labels=["A", "A", ""]))
        assert found.names == ("A", "A_2", "unnamed_3")
        assert any("called A" in note for note in found.notes)

    def test_refused_with_the_reason(self, tmp_path):
        (tmp_path / "no.c3d").write_text("nothing of the kind")
        with pytest.raises(RecordingError, match="not a C3D file"):
            read_markers(tmp_path / "no.c3d")
        whole = made.c3d(tmp_path / "a.c3d", np.ones((50, 3, 3))).read_bytes()
        (tmp_path / "cut.c3d").write_bytes(whole[:600])
        with pytest.raises(RecordingError, match=r"cut\.c3d"):
            read_markers(tmp_path / "cut.c3d")
        with pytest.raises(RecordingError, match="has no point"):
            read_markers(made.c3d(tmp_path / "b.c3d", np.ones((5, 0, 3))))
        with pytest.raises(RecordingError, match="unit of length is 'parsec'"):
            read_markers(made.c3d(tmp_path / "c.c3d", np.ones((5, 3, 3)), unit="parsec"))
        (tmp_path / "disguised.trc").write_bytes(whole)
        with pytest.raises(RecordingError, match="not a TRC file"):
            read_markers(tmp_path / "disguised.trc")


@pytest.mark.real
@pytest.mark.skipif(DATASETS is None, reason="UNOCCLUDE_DATASETS is not set")
class TestRealFiles:
    def test_every_file_at_hand_is_read(self):
        folder = Path(DATASETS) / "mocap"
        files = {
            str(path.relative_to(folder)) for path in folder.rglob("*") if path.suffix in (".c3d", ".trc")
        }
        assert set(REAL) <= files
        for name in sorted(files):  # those that are not listed are read as well, or refused in a sentence
            try:
                found = read_markers(folder / name)
            except RecordingError:
                assert name not in REAL
                continue
            assert np.nanmax(np.abs(found.position)) < 20  # metres, in a room
            assert (np.diff(found.t_s) > 0).all()
            if name in REAL:
                frames, markers, rate, seen = REAL[name]
                assert (len(found), len(found.names)) == (frames, markers), name
                assert found.rate_hz == pytest.approx(rate, abs=0.01), name
                there = np.isfinite(found.position).all(axis=2)
                assert 100 * there.mean() == pytest.approx(seen, abs=0.06), name

    def test_the_same_trial_in_both_formats(self):
        folder = Path(DATASETS) / "mocap" / "opensim-core"
        trc, c3d = (read_markers(folder / f"test_walking.{kind}") for kind in ("trc", "c3d"))
        assert trc.names == c3d.names
        np.testing.assert_allclose(trc.t_s, c3d.t_s, atol=1e-9)
        np.testing.assert_array_equal(np.isnan(trc.position), np.isnan(c3d.position))
        # 0.01 mm is what the text holds
        np.testing.assert_allclose(trc.position, c3d.position, atol=1e-5)


def test_a_c3d_header_without_points_whose_data_begin_behind_the_end(tmp_path: Path):
    """Found by fuzzing: no bytes are needed, and fewer than none are there."""
    header = np.zeros(256, "<u2")
    header[0], header[8] = 0x5002, 9  # the parameters' block, and that of the data
    path = tmp_path / "a.c3d"
    path.write_bytes(header.tobytes() + bytes(40))
    with pytest.raises(RecordingError, match="cut off: it contains 0 % of the frames"):
        _refuse_cut_off(path, {})
