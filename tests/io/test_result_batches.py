"""Results from columns in files: the same bytes; and a disk that is full."""

from __future__ import annotations

import errno
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_results import assert_same, recovery

from smoother.errors import UnoccludeError
from smoother.io import read_recovery, write_recovery
from smoother.io.result.tables import SAMPLES
from smoother.result import Recovery
from smoother.runtime import store
from smoother.runtime.store import large_array


def on_disk(made: Recovery) -> Recovery:
    """The recovery with its columns in files."""

    def put(values: np.ndarray) -> np.ndarray:
        array = large_array(values.shape, 0, values.dtype)
        array[:] = values
        return array

    return replace(
        made,
        **{name: put(getattr(made, name)) for name in ("t_s", *SAMPLES)},
        joints={joint: put(values) for joint, values in made.joints.items()},
        joint_covariance={joint: put(values) for joint, values in made.joint_covariance.items()},
    )


def test_columns_in_files_give_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_SMALL_BYTES", 1)
    monkeypatch.setattr("smoother.io.result.tables._ROWS", 64)
    made = recovery()
    write_recovery(made, tmp_path / "memory.mcap")
    kept = on_disk(made)
    write_recovery(kept, tmp_path / "files.mcap")
    assert_same(made, kept)
    assert (tmp_path / "files.mcap").read_bytes() == (tmp_path / "memory.mcap").read_bytes()
    assert_same(made, read_recovery(tmp_path / "files.mcap")[0])


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
