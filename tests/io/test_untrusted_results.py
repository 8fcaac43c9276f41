"""Trust in everything that is written of a result: wholly trusted, partly, not at all, and not judged."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap_messages import decoded
from results import made, read_mot

from smoother.io import write_recovery
from smoother.io.export.prepare import prepare_export
from smoother.io.export.tables import export_csv
from smoother.io.result.streams import RECOVERED, UNTRUSTED, VISIBLE
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval
from smoother.result.untrusted import standing, untrusted_gaps, untrusted_sentences, usable

BODY = UntrustedInterval(9.0, 12.0, ("another person's joints",))
SEEN = UntrustedInterval(15.0, 15.5, ("the camera was pushed",))
CHECK = SelfCheck(8, 1, 1.7, 0.011, 0.010, 0.96, 1.4, 1.1)
ESTIMATES = {
    "sound": Estimates(trusted=True),
    "partly": Estimates(
        trusted=True,
        cautions=("some of it",),
        untrusted=(BODY, SEEN),
        self_check=CHECK,
        pairing=Pairing(True, 1e-4, 120.0),
    ),
    "wrong": Estimates(trusted=False, reasons=("mirrored", "gravity is off"), cause="mirrored"),
    "unjudged": Estimates(),
}


def result(kind: str) -> Recovery:
    """Twenty seconds with gaps at 4 to 5 and 9 to 11.5 s."""
    return replace(made(), estimates=ESTIMATES[kind])


def expected(recovery: Recovery, kind: str) -> np.ndarray | None:
    """(N,) what `trusted` has to be, sample by sample; None where nobody judged."""
    if kind == "unjudged":
        return None
    t = recovery.t_s
    bad = ((t >= 9.0) & (t < 12.0)) | ((t >= 15.0) & (t < 15.5))
    return {"sound": np.ones(len(t), bool), "partly": ~bad, "wrong": np.zeros(len(t), bool)}[kind]


@pytest.mark.parametrize("kind", ESTIMATES)
def test_every_row_says_whether_it_is_trusted(tmp_path: Path, kind: str) -> None:
    recovery = result(kind)
    wanted = expected(recovery, kind)
    export_csv(recovery, tmp_path / "a.csv")
    prepare_export(recovery, "parquet").write(tmp_path / "a.parquet", False)
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[-2:] == ["trusted", "usable"]
    parquet, table = pq.read_table(tmp_path / "a.parquet"), recovery.to_table()
    assert table.column_names[-1] == "trusted"
    arrays = recovery.to_arrays()
    if wanted is None:
        assert {row["trusted"] for row in rows} == {""}
        assert {row["usable"] for row in rows} == {"1"}
        for one in (parquet["trusted"], table["trusted"]):
            assert one.null_count == len(recovery)
        assert "trusted" not in arrays
        return
    assert [row["trusted"] for row in rows] == [str(int(each)) for each in wanted]
    assert [row["usable"] for row in rows] == [str(int(each)) for each in wanted]
    for one in (parquet["trusted"], parquet["usable"], table["trusted"]):
        assert one.to_pylist() == wanted.tolist()
    np.testing.assert_array_equal(arrays["trusted"], wanted)


def test_a_limit_on_sigma_and_distrust_both_count() -> None:
    recovery = result("partly")
    sigma = np.median(recovery.worst_sigma_m)
    limited = replace(recovery, estimates=replace(recovery.estimates, max_sigma_m=float(sigma)))
    np.testing.assert_array_equal(usable(limited), (recovery.worst_sigma_m <= sigma) & recovery.trusted)


@pytest.mark.parametrize("kind", ESTIMATES)
def test_c3d_and_mot(tmp_path: Path, kind: str) -> None:
    recovery = result(kind)
    wanted = expected(recovery, kind)
    prepare_export(recovery, "c3d").write(tmp_path / "a.c3d", False)
    file = ezc3d.c3d(str(tmp_path / "a.c3d"))
    names = file["parameters"]["ANALOG"]["LABELS"]["value"]
    about = file["parameters"]["UNOCCLUDE"]
    prepare_export(recovery, "mot").write(tmp_path / "a.mot", False)
    head = (tmp_path / "a.mot").read_text().partition("endheader")[0]
    _, columns, table = read_mot(tmp_path / "a.mot")
    if wanted is None:
        assert "trusted" not in names and "trusted" not in columns
        assert about["VERDICT"]["value"] == ["nobody judged"]
        return
    np.testing.assert_array_equal(file["data"]["analogs"][0, names.index("trusted")], wanted)
    np.testing.assert_array_equal(table[:, columns.index("trusted")], wanted)
    assert recovery.estimates.verdict in head
    if kind == "partly":
        assert "gap 2" in about["UNTRUSTED"]["value"][0] and "another person's joints" in head


@pytest.mark.parametrize("kind", ESTIMATES)
def test_gaps_as_events(tmp_path: Path, kind: str) -> None:
    write_recovery(result(kind), tmp_path / "a.mcap")
    found = decoded(tmp_path / "a.mcap")
    about = [{each.key: each.value for each in event.metadata} for event in found["/unocclude/gaps"]]
    words = {"sound": ["true"] * 2, "partly": ["true", "false"], "wrong": ["false"] * 2}
    assert [each.get("trusted") for each in about] == words.get(kind, [None] * 2)
    reasons = {"partly": [None, "another person's joints"], "wrong": ["mirrored; gravity is off"] * 2}
    assert [each.get("reasons") for each in about] == reasons.get(kind, [None] * 2)
    lines = [line.message for line in found["/unocclude/log"]]
    assert ["not to be trusted" in line for line in lines] == [
        why is not None for why in reasons.get(kind, [None] * 2)
    ]


@pytest.mark.parametrize("kind", ESTIMATES)
def test_the_drawn_arm_is_dark_red_where_it_is_not_trusted(tmp_path: Path, kind: str) -> None:
    recovery = result(kind)
    write_recovery(recovery, tmp_path / "a.mcap")
    found = decoded(tmp_path / "a.mcap")
    colours = {VISIBLE: 0, RECOVERED: 1, UNTRUSTED: 2}
    drawn = []
    for update in found["/unocclude/arm"]:
        one = update.entities[0].spheres[0].color
        drawn.append(
            next(k for colour, k in colours.items() if np.allclose(colour, (one.r, one.g, one.b, one.a)))
        )
    wanted = np.where(recovery.trusted, recovery.occluded, 2)
    assert drawn == wanted[:: round(len(wanted) / len(drawn))].tolist()
    assert (2 in drawn) == (kind in ("partly", "wrong"))
    beads = {cloud.data[12:16] for cloud in found["/unocclude/beads"]}
    assert len(beads) == len(set(drawn))


def test_in_words() -> None:
    partly = result("partly")
    assert untrusted_gaps(partly) == [2]
    first, second = untrusted_sentences(partly)
    assert first.startswith("gap 2 (") and first.endswith(": another person's joints")
    assert second == "15.00 to 15.50 s, in view: the camera was pushed"
    assert standing(partly).startswith("Usable with care: some of it. Not to be trusted: gap 2 (")
    assert "while in view: 15.00 to 15.50 s." in standing(partly)
    assert untrusted_sentences(result("wrong")) == ()  # the verdict says it
    assert standing(result("wrong")) == "Not to be trusted: mirrored."
    assert standing(result("unjudged")) == ""
    every = tuple(UntrustedInterval(gap.start_s, gap.end_s, ("x",)) for gap in partly.gaps)
    both = replace(partly, estimates=replace(partly.estimates, untrusted=every))
    assert "Not to be trusted: gaps 1 (" in standing(both)
