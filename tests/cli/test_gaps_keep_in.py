"""`gaps --keep-in` and what `smooth` makes of the file; several recordings; real gaps against hidden ones."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from smoother.cli.run import run
from smoother.io import read_recovery


def call(*arguments: object) -> int:
    return run([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gaps")
    for seed in (1, 2):
        options = ("--protocol", "random", "--duration-s", 20, "--seed", seed)
        assert call("simulate", "arm", "--preset", "azure", *options, "-o", folder / f"{seed}.mcap") == 0
    return folder


def hide(folder: Path, *more: object) -> int:
    files = (folder / "1.mcap", folder / "2.mcap")
    return call("gaps", *files, "--lengths", "0.5", "--processes", 1, "--force", *more)


def test_keep_and_apply(folder: Path, capsys: pytest.CaptureFixture[str]):
    kept, figures = folder / "cal.toml", folder / "gaps.json"
    kept.write_text("[imu.base.gyroscope]\n# kept\noffset = [0.0, 0.0, 0.0]\n", encoding="utf-8")
    assert hide(folder, "--keep-in", kept, "--json", figures, "--report", folder / "gaps.html") == 0
    printed = capsys.readouterr().out
    assert "Sigma correction factor" in printed
    assert "Gaps were hidden where the camera saw the arm" in printed
    values = json.loads(figures.read_text())
    assert {row["recording"] for row in values["rows"]} == {"1.mcap", "2.mcap"}
    assert values["real_gaps"]["count"] > 0 and values["real_gaps"]["sentence"]
    assert "Gaps were hidden where" in (folder / "gaps.html").read_text(encoding="utf-8")
    table = tomllib.loads(kept.read_text())["sigma"]
    assert "# kept" in kept.read_text() and table["recordings"] == ["1.mcap", "2.mcap"]
    (row,) = table["gaps"]
    assert row["count"] == len(values["rows"]) and row["factor"] >= 1.0

    # the same table with a factor that nobody can overlook
    kept.write_text(kept.read_text().replace(f"factor = {row['factor']}", "factor = 3.0"), encoding="utf-8")
    recording = folder / "1.mcap"
    assert (
        call("smooth", recording, "-o", folder / "plain.mcap", "--processes", 1, "--draws", 0, "--force") == 0
    )
    assert "was multiplied" not in capsys.readouterr().out
    outputs = ("-o", folder / "wide.mcap", "--json", folder / "wide.json", "--force")
    assert call("smooth", recording, *outputs, "--processes", 1, "--calibration", kept, "--verbose") == 0
    assert "sigma of positions in gaps was multiplied by 3.00" in capsys.readouterr().out
    (plain,), (wide,) = read_recovery(folder / "plain.mcap"), read_recovery(folder / "wide.mcap")
    np.testing.assert_allclose(wide.position, plain.position, atol=1e-9)
    rows = plain.occluded & np.isfinite(plain.worst_sigma_m)
    np.testing.assert_allclose(wide.worst_sigma_m[rows], 3.0 * plain.worst_sigma_m[rows], rtol=1e-6)
    seen = ~plain.occluded
    np.testing.assert_allclose(wide.worst_sigma_m[seen], plain.worst_sigma_m[seen], rtol=1e-6)
    assert set(wide.estimates.sigma_factors) == {3.0}
    assert set(json.loads((folder / "wide.json").read_text())["figures"]["sigma_factors"]) == {3.0}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[sigma]\n", "sigma.gaps"),
        ("[sigma]\ngaps = [{length_s = 1.0, factor = -1.0, count = 3}]\n", "sigma.gaps.0.factor"),
        (
            "[sigma]\ngaps = [{length_s = 1, factor = 2, count = 3},"
            " {length_s = 1, factor = 3, count = 9}]\n",
            "twice",
        ),
    ],
)
def test_what_is_wrong_in_the_file(folder: Path, capsys: pytest.CaptureFixture[str], text: str, words: str):
    (folder / "bad.toml").write_text(text, encoding="utf-8")
    assert (
        call("smooth", folder / "1.mcap", "-o", folder / "x.mcap", "--calibration", folder / "bad.toml") == 1
    )
    said = capsys.readouterr()
    assert words in said.err + said.out and "bad.toml" in said.err + said.out
    assert not (folder / "x.mcap").exists()


def test_what_cannot_be_kept(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert hide(folder, "--keep-in", folder / "new.toml", "--methods", "linear") == 2
    assert call("gaps", folder / "1.mcap", folder / "1.mcap") == 2
    assert not (folder / "new.toml").exists()
    (folder / "broken.toml").write_text("x = [", encoding="utf-8")
    assert hide(folder, "--keep-in", folder / "broken.toml") == 1
    assert "broken.toml" in capsys.readouterr().err
