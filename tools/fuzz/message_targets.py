"""Messages without their container: what is decoded of bytes by schema."""

from __future__ import annotations

import numpy as np


def _fed(data: bytes, encoding: str, schemas: tuple[str, ...]) -> None:
    """Messages of each schema, cut from the input by its first byte."""
    from smoother.io.mcap.messages import Topic, TopicMessages
    from smoother.io.recording.decode import plain_decoder, skeleton_decoder
    from smoother.io.recording.json_messages import json_decoder

    size = max(data[0], 1) * 8 if data else 1
    start = np.arange(1, max(len(data), 2), size)
    stop = np.minimum(start + size, len(data))
    for schema in schemas:
        topic = Topic("/imu/forearm", schema, "", b"", encoding)
        decoder = plain_decoder(topic) or skeleton_decoder(topic) or json_decoder(topic)
        assert decoder is not None, schema
        decoder.feed(TopicMessages(np.arange(len(start)), data, start, np.maximum(stop, start)))
        if hasattr(decoder, "arms"):
            decoder.arms()
        else:
            decoder.stream()


def cdr(data: bytes) -> None:
    """ROS 2 messages."""
    kinds = ("Imu", "MagneticField")
    schemas = [f"sensor_msgs/msg/{kind}" for kind in kinds]
    _fed(data, "cdr", (*schemas, "geometry_msgs/msg/PoseStamped", "visualization_msgs/msg/MarkerArray"))


def protobuf(data: bytes) -> None:
    """Our messages and Foxglove's."""
    _fed(data, "protobuf", ("unocclude.Imu", "unocclude.Skeleton", "foxglove.PoseInFrame"))


def json_messages(data: bytes) -> None:
    """Messages in JSON."""
    _fed(data, "json", ("unocclude.Imu", "unocclude.Skeleton", "foxglove.PoseInFrame"))
