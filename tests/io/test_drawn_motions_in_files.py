"""Drawn motions in a result file and in Parquet: nothing lost but what 16 bits cannot hold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from made_results import ZERO, recovery

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import read_recovery, write_recovery
from smoother.io.result import messages as draw_messages
from smoother.result import Draws, Recovery


def with_draws(count: int = 5, side: str = "right", seed: int = 0) -> Recovery:
    made = recovery(side=side, seed=seed)
    t = made.t_s[::4]
    rng = np.random.default_rng(seed)

    def drawn(size: float) -> np.ndarray:
        values = np.cumsum(rng.normal(0.0, size, (count, len(t), 3)), axis=1).astype(np.float32)
        values[:, 2] = np.nan  # samples 8 to 11: no answer in the first of them
        return values

    joints = {"elbow": drawn(0.001), "wrist": drawn(0.002)}
    return replace(made, draws=Draws(t, 11, drawn(0.001), drawn(0.003), joints, {"upper_arm": drawn(0.01)}))


def assert_close(one: np.ndarray, other: np.ndarray) -> None:
    assert one.shape == other.shape and other.dtype == np.float32
    # a number is rounded to the largest in its second over 32767
    np.testing.assert_allclose(other, one, rtol=0, atol=0.51 * np.nanmax(np.abs(one)) / 32767 + 1e-7)


def test_round_trip(tmp_path: Path) -> None:
    made = with_draws()
    write_recovery(made, tmp_path / "a.mcap")
    (found,) = read_recovery(tmp_path / "a.mcap")
    assert made.draws is not None and found.draws is not None
    assert found.draws.seed == 11 and len(found.draws) == 5
    np.testing.assert_array_equal(found.draws.t_s, made.draws.t_s)
    assert_close(made.draws.position, found.draws.position)
    assert_close(made.draws.rotation, found.draws.rotation)
    assert list(found.draws.joints) == ["elbow", "wrist"]
    assert_close(made.draws.joints["wrist"], found.draws.joints["wrist"])
    assert list(found.draws.turns) == ["upper_arm"]
    assert_close(made.draws.turns["upper_arm"], found.draws.turns["upper_arm"])
    drawn = found.drawn(3)
    assert np.isfinite(drawn.position).all(axis=1).sum() > 350


def test_two_arms_and_one_without(tmp_path: Path) -> None:
    made = [with_draws(3, "left", 1), replace(with_draws(3, "right", 2), draws=None)]
    write_recovery(made, tmp_path / "a.mcap")
    left, right = read_recovery(tmp_path / "a.mcap")
    assert left.draws is not None and made[0].draws is not None and right.draws is None
    assert_close(made[0].draws.position, left.draws.position)


def test_without_draws_a_file_has_no_word_of_them(tmp_path: Path) -> None:
    write_recovery(recovery(), tmp_path / "a.mcap")
    assert b"raws" not in (tmp_path / "a.mcap").read_bytes()


def test_a_damaged_message_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = draw_messages.draw_messages

    def cut(*arguments: object) -> list[bytes]:
        return [message[:-5] for message in whole(*arguments)]  # type: ignore[arg-type]

    monkeypatch.setattr("smoother.io.result.streams.draw_messages", cut)
    write_recovery(with_draws(), tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match=r"a\.mcap: messages of its result are damaged.*smooth` again"):
        read_recovery(tmp_path / "a.mcap")


def test_missing_messages_are_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smoother.io.result.streams.RecoveryStreams._draws", lambda *_: [])
    write_recovery(with_draws(), tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match="its drawn motions are missing"):
        read_recovery(tmp_path / "a.mcap")


def test_parquet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = with_draws()
    write_recovery(made, tmp_path / "a.mcap")
    out = tmp_path / "draws.parquet"
    command = ["export", str(tmp_path / "a.mcap"), "--format", "parquet", "--draws", "-o", str(out)]
    assert run(command) == 0
    assert "(500 rows)" in capsys.readouterr().out
    table = pyarrow.parquet.read_table(out)
    about = json.loads(table.schema.metadata[b"unocclude"])
    assert about["motions"] == 5 and about["seed"] == 11 and about["side"] == "right"
    columns = {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
    (found,) = read_recovery(tmp_path / "a.mcap")
    for k in (0, 4):
        rows, drawn = columns["motion"] == k, found.drawn(k).rows(np.arange(0, 400, 4))
        for name, expected in (
            ("imu_y", drawn.position[:, 1]),
            ("imu_qx", drawn.quaternion[:, 1]),
            ("wrist_z", drawn.joints["wrist"][:, 2]),
        ):
            values = columns[name][rows]
            known = np.isfinite(values)
            assert not known[2] and known.sum() > 85  # nothing was drawn there; a motion is continued across
            np.testing.assert_allclose(values[known], expected[known], atol=1e-5)
        np.testing.assert_allclose(1e-9 * (columns["stamp_ns"][rows] - ZERO), drawn.t_s, atol=1e-9)


def test_what_cannot_be_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recovery(recovery(), tmp_path / "a.mcap")
    out = tmp_path / "d.parquet"
    assert run(["export", str(tmp_path / "a.mcap"), "--format", "parquet", "--draws", "-o", str(out)]) == 1
    assert "has no drawn motions; run `unocclude smooth` with --draws 64" in capsys.readouterr().err
    assert not out.exists()
    assert run(["export", str(tmp_path / "a.mcap"), "--format", "csv", "--draws", "-o", "d.csv"]) == 2
    assert "--draws is for parquet, not for csv" in capsys.readouterr().err
