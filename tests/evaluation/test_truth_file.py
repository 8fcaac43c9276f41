"""Truth read from a CSV file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery, make_truth

from smoother.errors import RecordingError
from smoother.evaluation.truth import read_truth
from smoother.evaluation.validate import validate


@pytest.fixture(scope="module")
def recovery():
    return make_recovery(make_recording(6.0))


def write(path, truth, header="t_s,x,y,z,qw,qx,qy,qz", shift=0.0, orientation=True):
    lines = [header]
    for t, p, q in zip(truth.t_s, truth.position, truth.quaternion, strict=True):
        cells = [t + shift, *p, *q] if orientation else [t + shift, *p]
        lines.append(",".join(f"{cell:.9f}" for cell in cells))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_round_trip(tmp_path, recovery):
    truth = make_truth(np.arange(0, 6, 0.01))
    read = read_truth(write(tmp_path / "truth.csv", truth), recovery)
    np.testing.assert_allclose(read.position, truth.position, atol=1e-8)
    np.testing.assert_allclose(read.quaternion, truth.quaternion, atol=1e-8)
    assert validate(recovery, read).all.position_rms_m < 1e-5


@pytest.mark.parametrize("header", ["t_s,x,y,z", "t_s, x, y, z, qw, qx, qy, qz"])
def test_orientation_missing_or_empty(tmp_path, recovery, header):
    truth = make_truth(np.arange(0, 6, 0.01))
    path = write(tmp_path / "truth.csv", truth, header, orientation=False)
    if "qw" in header:
        text = path.read_text().splitlines()
        path.write_text("\ufeff" + "\r\n".join([text[0]] + [line + ",,,," for line in text[1:]]))
    found = validate(recovery, read_truth(path, recovery))
    assert found.all.orientation_rms_deg is None
    assert found.all.position_rms_m < 1e-5


def test_unix_times_and_relative_times(tmp_path, recovery):
    truth = make_truth(np.arange(0, 6, 0.01))
    unix = replace(recovery, origin_ns=1_700_000_000_000_000_000)
    path = write(tmp_path / "unix.csv", truth, shift=1.7e9)
    assert validate(unix, read_truth(path, unix)).all.position_rms_m < 1e-4
    path = write(tmp_path / "relative.csv", truth)
    assert validate(unix, read_truth(path, unix)).all.position_rms_m < 1e-5


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.csv", "", "column t_s, x, y, z is missing; the file has nothing"),
        ("a.csv", "time,x,y,z\n0,1,2,3\n", "column t_s is missing; the file has time, x, y, z"),
        ("a.csv", "t_s,x,y,z\n0,1,2,3\n0.1,1,two,3\n", "line 3: 'two' in column y is no number"),
        ("a.csv", "t_s,x,y,z\n", "no row has a time"),
        ("a.txt", "", "a truth is read from .c3d or .trc"),
        ("a.csv", None, "there is no such file"),
    ],
)
def test_bad_files_are_one_sentence(tmp_path, recovery, name, text, sentence):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(RecordingError) as caught:
        read_truth(path, recovery)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_binary_is_refused(tmp_path, recovery):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\x89\x00\xff\xfe" * 10)
    with pytest.raises(RecordingError, match="not a CSV file"):
        read_truth(path, recovery)
