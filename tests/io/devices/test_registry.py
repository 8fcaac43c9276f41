"""The table of importers, and the example of one in CONTRIBUTING."""

from __future__ import annotations

import re
from pathlib import Path

import device_files as made
import numpy as np
import pytest
from imu_files import rows

from smoother.errors import RecordingError
from smoother.io.devices.registry import format_named, formats, recognise, unknown_file
from smoother.io.tables.imu_columns import ImuFormat
from smoother.io.tables.protocol import decode, read_head, shown
from smoother.io.tables.text_table import read_sheet

ROOT = Path(__file__).parents[3]


def test_every_importer_has_a_page_and_a_sentence():
    index = (ROOT / "docs" / "devices.md").read_text(encoding="utf-8")
    assert len({importer.key for importer in formats()}) == len(formats())
    for importer in formats():
        assert (ROOT / "docs" / "devices" / f"{importer.key}.md").exists(), importer.key
        assert f"devices/{importer.key}.md" in index
        assert importer.title and importer.recognised_by and importer.kind in ("imu", "skeleton", "recording")
        assert format_named(importer.key) is importer


@pytest.mark.parametrize("key", sorted(made.EXAMPLES))
def test_only_one_importer_recognises_an_example(tmp_path: Path, key: str):
    made.EXAMPLES[key](tmp_path / "file")
    head = read_head(tmp_path / "file")
    importer = recognise(head)
    assert importer is not None and importer.key == key


@pytest.mark.parametrize("key", sorted(made.IMUS))
def test_an_example_holds_the_motion(tmp_path: Path, key: str):
    made.IMUS[key](tmp_path / "file")
    table = format_named(key).read(tmp_path / "file")[0]
    coarse = 0.1 if key == "axivity" else 2e-5  # 16 bits, or six decimals of a g or a degree
    assert table.acc is None or np.allclose(table.acc, made.ACC, atol=coarse)
    assert table.gyro is None or np.allclose(table.gyro, made.GYRO, atol=coarse)
    assert table.acc is not None or table.gyro is not None
    assert table.t_s is None or np.allclose(np.diff(table.t_s), 0.01, atol=1e-4)


def test_heads(tmp_path: Path):
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"):
        assert decode("t,x\n1,2\n".encode(encoding)) == "t,x\n1,2\n"
    assert decode(bytes(range(256))) == "" and decode("Zeit;Größe\n".encode("cp1252")) == "Zeit;Größe\n"
    assert len(shown("\x1b[31mred\x00" * 900)) <= 200 and shown("a\x1b\n\tb") == "a b"
    for name, said in (("none", "does not exist"), ("", "is a folder")):
        with pytest.raises(RecordingError, match=said):
            read_head(tmp_path / name)


def test_the_example_of_contributing(tmp_path: Path):
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(ImuFormat\(.*?\n\))\n```", text, re.DOTALL)
    importer = eval(code, {"ImuFormat": ImuFormat})
    body = rows(np.arange(made.COUNT), made.ACC / made.GRAVITY * 1000, made.DEG)
    path = tmp_path / "acme.csv"
    path.write_text("\n".join(["tick,acc_x,acc_y,acc_z,rot_x,rot_y,rot_z", *body, ""]))
    assert importer.recognises(read_head(path))
    (table,) = importer.read(path)
    assert np.allclose(table.acc, made.ACC, atol=1e-6) and np.allclose(table.gyro, made.GYRO, atol=1e-6)
    assert np.allclose(table.t_s, np.arange(made.COUNT) * 1e-3)


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (
            b"PK\x03\x04\x14\x00\x00\x00\x08\x00[Content_Types].xml",
            "is an Excel workbook that cannot be read",
        ),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "is an Excel workbook of the old kind; save it as .xlsx"),
        (b"PK\x03\x04\x14\x00\x00\x00\x08\x00mimetype", "is an archive"),
        (b"SampleTimeFine,Acc_X,Acc_Y,Acc_Z\n", "has no rows; export it again"),
        (b"Zeit (s);Beschleunigung x (m/s^2)\r\n\r\n", "has no rows; export it again"),
    ],
)
def test_workbooks_archives_and_headers_alone(tmp_path: Path, raw: bytes, said: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(raw)
    assert said in str(unknown_file(read_head(path)))
    with pytest.raises(RecordingError, match=said):
        read_sheet(path)
