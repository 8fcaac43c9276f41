"""What shows or names a person stays out of results, however it is written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands import done
from mcap.reader import make_reader
from mcap.writer import Writer

from smoother.io.mcap.messages import Topic
from smoother.io.recording.carried import may_copy

PRIVATE = [
    ("/camera/rgb", "sensor_msgs/msg/Image", "cdr"),
    ("/camera/rgb/compressed", "sensor_msgs/msg/CompressedImage", "cdr"),
    ("/camera/rgbd", "realsense2_camera_msgs/msg/RGBD", "cdr"),
    ("/camera/jpeg", "", "jpeg"),
    ("/camera/jpeg2", "", ""),
    ("/camera/jpeg3", "sensor_msgs/msg/Imu", "jpeg"),
    ("/body_index_map", "k4a_msgs/msg/BodyIndexMap", "cdr"),
    ("/depth", "foxglove.RawImage", "protobuf"),
    ("/points", "sensor_msgs/msg/PointCloud2", "cdr"),
    ("/laser", "sensor_msgs/msg/LaserScan", "cdr"),
    ("/fix", "sensor_msgs/msg/NavSatFix", "cdr"),
    ("/fix2", "gps_msgs/msg/GPSFix", "cdr"),
    ("/fix3", "foxglove.LocationFix", "protobuf"),
    ("/video", "foxglove.CompressedVideo", "protobuf"),
    ("/audio", "foxglove.RawAudio", "protobuf"),
    ("/mesh", "foxglove.SceneUpdate", "protobuf"),
    ("/notes", "std_msgs/msg/String", "cdr"),
    ("/rosout", "rcl_interfaces/msg/Log", "cdr"),
    ("/grid", "std_msgs/msg/UInt8MultiArray", "cdr"),
    ("/new", "vendor_msgs/msg/SomethingNew", "cdr"),
]
MOTION = [
    ("/imu", "sensor_msgs/msg/Imu", "cdr"),
    ("/imu/old", "sensor_msgs/Imu", "ros1"),
    ("/mag", "sensor_msgs/msg/MagneticField", "cdr"),
    ("/body", "visualization_msgs/msg/MarkerArray", "cdr"),
    ("/tf", "tf2_msgs/msg/TFMessage", "cdr"),
    ("/pose", "foxglove.PoseInFrame", "protobuf"),
    ("/lens", "sensor_msgs/msg/CameraInfo", "cdr"),
    ("/skeleton", "unocclude.Skeleton", "protobuf"),
]


@pytest.mark.parametrize(("name", "schema", "encoding"), PRIVATE)
def test_what_shows_a_person_stays(name: str, schema: str, encoding: str):
    topic = Topic(name, schema, "", b"", encoding)
    assert not may_copy(topic, False) and may_copy(topic, True)


@pytest.mark.parametrize(("name", "schema", "encoding"), MOTION)
def test_motion_is_carried(name: str, schema: str, encoding: str):
    assert may_copy(Topic(name, schema, "", b"", encoding), False)


def test_from_file_to_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Through the command: no byte of what is private, and a sentence that says what was left out."""
    done(
        *("simulate", "arm", "--protocol", "random", "--duration-s", "10", "--seed", "3", "-o"),
        tmp_path / "plain.mcap",
    )
    with open(tmp_path / "rec.mcap", "wb") as file, open(tmp_path / "plain.mcap", "rb") as plain:
        writer = Writer(file)
        writer.start()
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(plain).iter_messages():
            if channel.topic not in channels:
                assert schema is not None
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, number
                )
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        for name, schema_name, encoding in PRIVATE[:12]:
            if schema_name not in schemas:
                schemas[schema_name] = writer.register_schema(schema_name, "", b"") if schema_name else 0
            writer.add_message(
                writer.register_channel(name, encoding, schemas[schema_name]),
                message.log_time,
                b"FACE OF A PATIENT",
                message.publish_time,
            )
        writer.finish()
    out = tmp_path / "out.mcap"
    done(
        *("smooth", tmp_path / "rec.mcap", "-o", out, "--processes", "1", "--draws", "0", "--json"),
        tmp_path / "out.json",
    )
    said = " ".join(capsys.readouterr().out.split())
    assert "Not carried over" in said and "--passthrough-images" in said and "/body_index_map" in said
    (sentence,) = json.loads((tmp_path / "out.json").read_text())["not_carried_over"]
    assert sentence in said
    with open(out, "rb") as file:
        data = {channel.topic: message.data for _, channel, message in make_reader(file).iter_messages()}
    assert set(channels) <= set(data)
    assert not any(b"PATIENT" in each for each in data.values())
    done(
        *("batch", tmp_path / "rec.mcap", "-o", tmp_path / "study", "--processes", "1", "--json"),
        tmp_path / "study.json",
    )
    assert sentence in " ".join(capsys.readouterr().out.split())
    (row,) = json.loads((tmp_path / "study.json").read_text())["rows"]
    assert sentence in row["note_texts"] and row["notes"] == len(row["note_texts"])
    again = tmp_path / "all.mcap"
    done(
        *("smooth", tmp_path / "rec.mcap", "-o", again, "--processes", "1", "--draws", "0"),
        "--passthrough-images",
    )
    with open(again, "rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert {name for name, *_ in PRIVATE[:12]} <= topics
