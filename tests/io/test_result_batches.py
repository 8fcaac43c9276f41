"""Results written a part of time at a time: the same file content, however they are cut, in flat memory."""

from __future__ import annotations

import errno
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_results import assert_same, recovery
from mcap.reader import make_reader

import smoother.io.result.write
from smoother.errors import UnoccludeError
from smoother.io import read_recovery, write_recording, write_recovery
from smoother.io.mcap.merge import END, TimeAxis, time_batches
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.runtime import store
from smoother.runtime.store import large_array


def cut(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(smoother.io.result.write, "time_batches", partial(time_batches, most=most))


def messages(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    """Topic, times, sequence and payload of all messages, sorted."""
    with open(path, "rb") as file:
        found = [
            (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
            for _, channel, message in make_reader(file).iter_messages()
        ]
    return sorted(found)


@settings(max_examples=60, deadline=None)
@given(
    times=st.lists(
        st.lists(st.floats(-5.0, 5.0).map(lambda t: round(t, 2)), max_size=60), min_size=1, max_size=3
    ),
    most=st.integers(1, 20),
)
def test_every_row_is_in_one_part_and_parts_follow_each_other(times: list[list[float]], most: int) -> None:
    axes = [TimeAxis(np.sort(np.array(each, float)), 10**9, 7) for each in times]
    parts = list(time_batches(axes, most))
    before = -END
    for part in parts:
        for axis, rows in zip(axes, part.rows, strict=True):
            log_ns = axis.log_ns(rows)
            assert len(log_ns) <= most or len(set(log_ns.tolist())) == 1
            # where time stands still for long, what is left of that moment comes in the next part
            assert ((log_ns >= before - 1) & (log_ns < part.until_ns)).all()
        before = part.until_ns
    assert parts[-1].until_ns == END
    for i, axis in enumerate(axes):
        edges = [0, *(part.rows[i].stop for part in parts)]
        assert edges[-1] == len(axis.t_s)
        assert [part.rows[i].start for part in parts] == edges[:-1]


def test_times_that_run_back_are_in_some_part() -> None:
    t = np.array([0.0, 1.0, 2.0, 0.5, 3.0, 2.5, 4.0, 4.0, 4.0, 4.0, 4.0, 5.0])
    parts = list(time_batches([TimeAxis(t, 0, 0)], 3))
    rows = np.concatenate([np.arange(len(t))[part.rows[0]] for part in parts])
    np.testing.assert_array_equal(rows, np.arange(len(t)))


@pytest.mark.parametrize("most", [1, 37])
def test_however_it_is_cut_the_messages_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recording: Recording, most: int
) -> None:
    write_recording(recording, tmp_path / "rec.mcap")
    counts = (80, 60) if most == 1 else (400, 300)  # a part for every moment is slow
    made = [recovery(counts[0], seed=1, side="right"), recovery(counts[1], seed=2, side="left")]
    write_recovery(made, tmp_path / "whole.mcap", source=tmp_path / "rec.mcap")
    cut(monkeypatch, most)
    write_recovery(made, tmp_path / "cut.mcap", source=tmp_path / "rec.mcap")
    assert messages(tmp_path / "cut.mcap") == messages(tmp_path / "whole.mcap")
    for one, other in zip(made, read_recovery(tmp_path / "cut.mcap"), strict=True):
        assert_same(one, other)
    with open(tmp_path / "cut.mcap", "rb") as file:
        log = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert log == sorted(log)


def test_log_times_that_run_back_are_held_across_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera clock that jumps back between two parts: log times wait for it, stamps stay as they are."""
    made = recovery()
    t = made.arm.t_s.copy()
    t[40:] -= 0.3
    made = replace(made, arm=replace(made.arm, t_s=t))
    write_recovery(made, tmp_path / "whole.mcap")
    cut(monkeypatch, 30)
    write_recovery(made, tmp_path / "cut.mcap")
    for name in ("whole", "cut"):
        log = [each[1] for each in messages(tmp_path / f"{name}.mcap") if each[0] == "/unocclude/camera"]
        assert len(log) == len(t) and min(np.diff(log)) >= 0


def on_disk(made: Recovery) -> Recovery:
    """The recovery with its columns in files."""

    def put(values: np.ndarray) -> np.ndarray:
        array = large_array(values.shape, 0, values.dtype)
        array[:] = values
        return array

    names = (
        "t_s",
        "occluded",
        "position",
        "quaternion",
        "velocity",
        "pose_covariance",
        "velocity_covariance",
    )
    return replace(
        made,
        **{name: put(getattr(made, name)) for name in names},
        joints={joint: put(values) for joint, values in made.joints.items()},
        joint_covariance={joint: put(values) for joint, values in made.joint_covariance.items()},
    )


def test_columns_in_files_give_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_SMALL_BYTES", 1)
    cut(monkeypatch, 64)
    made = recovery()
    write_recovery(made, tmp_path / "memory.mcap")
    kept = on_disk(made)
    write_recovery(kept, tmp_path / "files.mcap")
    for batch in kept.batches():
        assert len(batch)
    assert_same(made, kept)
    assert (tmp_path / "files.mcap").read_bytes() == (tmp_path / "memory.mcap").read_bytes()


def test_blocks_go_over_all_samples_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("recovery", "frame_residuals"):
        monkeypatch.setattr(f"smoother.result.{module}.BATCH_ROWS", 7)
    made = recovery(100)
    np.testing.assert_array_equal(np.concatenate([batch.t_s for batch in made.batches()]), made.t_s)
    overlapping = [batch.t_s for batch in made.batches(overlap=1)]
    assert all(after[0] == before[-1] for before, after in pairwise(overlapping))
    assert made.residuals is not None
    used = np.concatenate([batch.used for batch in made.residuals.batches()])
    np.testing.assert_array_equal(used, made.residuals.used)


def test_a_failure_while_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> Callable[..., None]:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("smoother.io.mcap.merge.Output._write_chunk", fail)
    with pytest.raises(UnoccludeError, match="no space left on the disk"):
        write_recovery(recovery(), tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []
