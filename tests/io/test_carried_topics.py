"""What shows or names a person stays out of results, however it is written."""

from __future__ import annotations

from pathlib import Path

from commands import done
from mcap.reader import make_reader
from mcap.writer import Writer

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


def test_from_file_to_file(tmp_path: Path):
    """Through the command: a result has no topic of its recording, and no byte of what is private."""
    done(
        *("simulate", "arm", "--set", "protocol=random", "--set", "duration_s=10", "--seed", "3", "-o"),
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
    done("smooth", tmp_path / "rec.mcap", "-o", out, "--processes", "1", "--draws", "0")
    with open(out, "rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert topics and all(topic.startswith("/unocclude/") for topic in topics)
    assert b"PATIENT" not in out.read_bytes()
