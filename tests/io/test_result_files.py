"""Recoveries and drawn motions written, read back and exported; trust in all that is written of them."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pyarrow
import pyarrow.parquet as pq
import pytest
import ros_bags as ros
from made_recordings import make
from made_results import ZERO, assert_same, recovery
from mcap.reader import make_reader
from mcap_messages import decoded, put
from results import made, read_mot

from smoother.errors import RecordingError, UnoccludeError
from smoother.io import open_recording, read_recording, read_recovery, write_recording, write_recovery
from smoother.io.export import prepare_export
from smoother.io.export.prepare import export_csv
from smoother.io.mcap.container import Container
from smoother.io.result.streams import ANSWER
from smoother.result import Draws, Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval
from smoother.result.untrusted import standing, untrusted_gaps, untrusted_sentences, usable


def test_a_method_with_little_to_say(tmp_path: Path) -> None:
    unknown = ("quaternion", "velocity", "pose_covariance", "velocity_covariance")
    made = recovery()
    made = replace(made, **{name: np.full_like(getattr(made, name), np.nan) for name in unknown})
    made = replace(made, gaps=(), calibration=None, residuals=None, joints={}, joint_covariance={})
    write_recovery(made, tmp_path / "a.mcap")
    assert_same(made, read_recovery(tmp_path / "a.mcap")[0])


def test_every_message_decodes(tmp_path: Path) -> None:
    made = recovery()
    write_recovery(made, tmp_path / "a.mcap")
    found = {topic.removeprefix("/unocclude/"): each for topic, each in decoded(tmp_path / "a.mcap").items()}
    counts = {name: len(found[name]) for name in ("skeleton", "joints", "arm", "forearm", "gaps")}
    # of every third sample one has no answer
    assert counts == {"skeleton": 134, "joints": 134, "arm": 134, "forearm": 133, "gaps": 2}
    assert all(len(each.entities) == 1 and each.entities[0].frame_id == "camera" for each in found["arm"])
    odometry = found["forearm"][0]
    assert odometry.timestamp.ToNanoseconds() == ZERO + 123456700
    assert odometry.body_frame_id == "forearm_imu"
    np.testing.assert_array_equal(np.reshape(odometry.pose_covariance, (6, 6)), made.pose_covariance[0])
    speed = np.linalg.norm([getattr(odometry.linear_velocity, axis) for axis in "xyz"])
    assert speed == pytest.approx(np.linalg.norm(made.velocity[0]))
    table = made.angles().to_arrays()
    wanted = {name.replace("_deg", "_right"): np.radians(values) for name, values in table.items()}
    angles = {name: np.full(len(made), np.nan) for name in wanted}
    for states in found["joints"]:
        row = np.argmin(np.abs(made.t_s - 1e-9 * (states.timestamp.ToNanoseconds() - made.origin_ns)))
        for joint in states.joints:
            angles[joint.name][row] = joint.position
    for name, values in wanted.items():
        np.testing.assert_allclose(angles[name][::3], values[::3], atol=1e-12, err_msg=name)
    assert np.isfinite(wanted["shoulder_plane_right"]).any()


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        write_recovery(recovery(), tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    with pytest.raises(UnoccludeError, match="force=True"):
        write_recovery(recovery(), tmp_path / "a.mcap")


def test_of_the_recording_only_axes_and_metadata_are_kept(tmp_path: Path) -> None:
    with ros.Bag(tmp_path / "rec.mcap") as bag:
        for i in range(20):
            # A sensor that counts from its own start, recorded on a computer's clock.
            ns, log = i * 10**7, ZERO + i * 10**7
            bag.imu("/wrist", ns, "w", np.array([0, 0, 9.8]), np.zeros(3), log)
            image = {"header": ros.header(ns, "rgb"), "height": 1, "width": 1, "encoding": "mono8"}
            image |= {"is_bigendian": 0, "step": 1, "data": b"\1"}
            bag.write("/rgb", "sensor_msgs/msg/Image", ros.IMAGE, image, log)
    made = recovery(origin_ns=0)
    write_recovery(made, tmp_path / "out.mcap", source=tmp_path / "rec.mcap")
    with open(tmp_path / "out.mcap", "rb") as file:
        messages = [
            (channel.topic, message.log_time) for _, channel, message in make_reader(file).iter_messages()
        ]
    assert all(topic.startswith("/unocclude/") for topic, _ in messages)
    # The result lies on the same time line as what it was made from.
    assert min(time for _, time in messages) >= ZERO
    assert_same(made, read_recovery(tmp_path / "out.mcap")[0])
    source = make()
    write_recording(source, tmp_path / "plain.mcap")
    write_recovery(recovery(), tmp_path / "two.mcap", source=tmp_path / "plain.mcap")
    again = open_recording(tmp_path / "two.mcap")
    assert again.camera_frame == source.camera_frame and not again.imus and not again.arms
    with pytest.raises(RecordingError, match="is a result; name the recording"):
        read_recording(tmp_path / "two.mcap")


HEADER = (
    "t_s,occluded,imu_x,imu_y,imu_z,imu_qw,imu_qx,imu_qy,imu_qz,elbow_x,elbow_y,elbow_z,wrist_x,wrist_y,wrist_z,"
    "shoulder_x,shoulder_y,shoulder_z,sigma_x,sigma_y,sigma_z,sigma_deg,wrist_sigma_x,wrist_sigma_y,wrist_sigma_z"
)


@pytest.mark.parametrize(("origin_ns", "first"), [(ZERO, "1700000000.123456700"), (-(10**9), "-0.876543300")])
def test_csv(tmp_path: Path, origin_ns: int, first: str) -> None:
    made = recovery(origin_ns=origin_ns)
    export_csv(made, tmp_path / "a.csv")
    text = (tmp_path / "a.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()))
    assert text.startswith(HEADER) and "nan" not in text and rows[0]["t_s"] == first
    assert rows[6]["imu_x"] == rows[6]["imu_qw"] == rows[6]["sigma_x"] == ""
    assert [row["occluded"] for row in rows] == [str(int(flag)) for flag in made.occluded]


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


def test_drawn_motions_round_trip_in_tables_that_others_read(tmp_path: Path) -> None:
    made = with_draws()
    write_recovery([made, replace(recovery(side="left"), residuals=None)], tmp_path / "a.mcap")
    left, right = sorted(read_recovery(tmp_path / "a.mcap"), key=lambda one: one.side)
    assert left.draws is None and made.draws is not None and right.draws is not None
    assert right.draws.seed == 11 and len(right.draws) == 5
    np.testing.assert_array_equal(right.draws.t_s, made.draws.t_s)
    columns = made.draws.columns()
    assert list(right.draws.columns()) == list(columns)
    for name, values in right.draws.columns().items():
        assert values.shape == columns[name].shape and values.dtype == np.float32
        np.testing.assert_allclose(values, columns[name], rtol=0, atol=2.0**-18)
    assert np.isfinite(right.drawn(3).position).all(axis=1).sum() > 350
    with open(tmp_path / "a.mcap", "rb") as file:
        tables = {each.name: each for each in make_reader(file, validate_crcs=True).iter_attachments()}
    names = {f"right/{table}" for table in ("samples", "frames", "residuals", "draws")}
    names |= {"left/samples", "left/frames"}
    assert tables.keys() == {f"unocclude.result/{name}.parquet" for name in names}
    table = pq.read_table(pyarrow.BufferReader(tables["unocclude.result/right/samples.parquet"].data))
    np.testing.assert_array_equal(np.array(table["wrist/position"].to_pylist()), made.joints["wrist"])
    assert table["stamp_ns"].to_pylist()[0] == ZERO + 123456700


def test_damaged_missing_and_older_results_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    write_recovery(recovery(), path)
    whole = path.read_bytes()
    at = Container(path).skimmed().attachments["unocclude.result/samples.parquet"][0] + 500
    path.write_bytes(put(whole, at, bytes([whole[at] ^ 1])))
    with pytest.raises(RecordingError, match=r"its result is damaged.*fails its checksum.*smooth` again"):
        read_recovery(path)
    path.write_bytes(whole[: at + 1000])
    with pytest.raises(RecordingError, match=r"its result is damaged.*ends in the middle of the recording"):
        read_recovery(path)
    monkeypatch.setattr("smoother.io.result.write.tables_of", lambda _: {})
    write_recovery(recovery(), path, force=True)
    with pytest.raises(RecordingError, match=r"is a result of version .*from before 1.0 are not read"):
        read_recovery(path)
    write_recording(make(), path, force=True)
    with pytest.raises(RecordingError, match="has no result"):
        read_recovery(path)


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


#: Of both gaps: whether the event says it is trusted, and the reasons.
GAPS = {
    "sound": (["true"] * 2, [None] * 2),
    "partly": (["true", "false"], [None, "another person's joints"]),
    "wrong": (["false"] * 2, ["mirrored; gravity is off"] * 2),
    "unjudged": ([None] * 2, [None] * 2),
}


@pytest.mark.parametrize("kind", ESTIMATES)
def test_gaps_are_events_and_the_drawn_arm_is_dark_red_where_it_is_not_trusted(tmp_path: Path, kind: str):
    recovery, (trusted, reasons) = result(kind), GAPS[kind]
    write_recovery(recovery, tmp_path / "a.mcap")
    found = decoded(tmp_path / "a.mcap")
    about = [{each.key: each.value for each in event.metadata} for event in found["/unocclude/gaps"]]
    assert [each.get("trusted") for each in about] == trusted
    assert [each.get("reasons") for each in about] == reasons
    lines = [line.message for line in found["/unocclude/log"]]
    assert ["not to be trusted" in line for line in lines] == [why is not None for why in reasons]
    spheres = [update.entities[0].spheres[0].color for update in found["/unocclude/arm"]]
    colours = np.array([(one.r, one.g, one.b, one.a) for one in spheres])
    drawn = np.abs(colours[:, None] - np.array(ANSWER)).max(axis=2).argmin(axis=1)
    np.testing.assert_allclose(np.array(ANSWER)[drawn], colours, atol=1e-6)
    wanted = np.where(recovery.trusted, recovery.occluded, 2)
    assert drawn.tolist() == wanted[:: round(len(wanted) / len(drawn))].tolist()
    assert (2 in drawn) == (kind in ("partly", "wrong"))
    assert len({cloud.data[12:16] for cloud in found["/unocclude/beads"]}) == len(set(drawn.tolist()))


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
