"""Which topics of a recording are copied into files made of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..mcap.messages import Topic

#: Encodings whose content is what the schema says.
_ENCODINGS = {"cdr", "protobuf", "ros1"}
#: Schemas of motion, time and lenses: they contain no image, name or address of a person.
_SCHEMAS = {
    f"{package}{name}"
    for package, names in {
        "sensor_msgs/": (
            "Imu",
            "MagneticField",
            "JointState",
            "CameraInfo",
            "Temperature",
            "FluidPressure",
            "TimeReference",
        ),
        "geometry_msgs/": (
            "Pose",
            "PoseStamped",
            "PoseWithCovarianceStamped",
            "PoseArray",
            "Transform",
            "TransformStamped",
            "Point",
            "PointStamped",
            "Vector3",
            "Vector3Stamped",
            "Quaternion",
            "QuaternionStamped",
            "Twist",
            "TwistStamped",
            "TwistWithCovarianceStamped",
            "Accel",
            "AccelStamped",
            "AccelWithCovarianceStamped",
            "Wrench",
            "WrenchStamped",
        ),
        "nav_msgs/": ("Odometry",),
        "std_msgs/": (
            "Bool",
            "Header",
            "Time",
            "Duration",
            "Float32",
            "Float64",
            "Int8",
            "Int16",
            "Int32",
            "Int64",
            "UInt8",
            "UInt16",
            "UInt32",
            "UInt64",
        ),
        "tf2_msgs/": ("TFMessage",),
        "tf/": ("tfMessage",),
        "rosgraph_msgs/": ("Clock",),
        "visualization_msgs/": ("MarkerArray",),
        "foxglove.": (
            "FrameTransform",
            "FrameTransforms",
            "PoseInFrame",
            "PosesInFrame",
            "JointState",
            "JointStates",
            "Odometry",
            "CameraCalibration",
            "Event",
        ),
        "unocclude.": (
            "Imu",
            "Skeleton",
            "Keypoints2D",
            "Residuals",
        ),
    }.items()
    for name in names
}


#: How the sentence on topics that were left out begins.
NOT_PASSED_THROUGH = "Not carried over"


def may_copy(topic: Topic, passthrough_images: bool) -> bool:
    """Whether a topic of a recording is copied into files made of it.

    Images in any form, sound, text, positions on Earth and whatever is not known do not, unless asked for.

    Parameters
    ----------
    topic : Topic
        By its schema and encoding; its name is not used.
    passthrough_images : bool
        Copy everything.
    """
    if passthrough_images:
        return True
    return topic.encoding in _ENCODINGS and topic.schema.replace("/msg/", "/") in _SCHEMAS


@dataclass
class Passthrough:
    """Decides of topics and remembers which were left out.

    Attributes
    ----------
    passthrough_images : bool
        Copy everything.
    left_out : dict of str to str
        Schemas by topics that were not copied.
    """

    passthrough_images: bool
    left_out: dict[str, str] = field(default_factory=dict)

    def __call__(self, topic: Topic) -> bool:
        """Whether to copy a topic."""
        if may_copy(topic, self.passthrough_images):
            return True
        self.left_out[topic.name] = topic.schema or topic.encoding or "no schema"
        return False

    @property
    def sentence(self) -> str:
        """What was left out, for the user; "" for nothing."""
        if not self.left_out:
            return ""
        listed = [f"{name} ({schema})" for name, schema in sorted(self.left_out.items())]
        more = f" and {len(listed) - 5} more" if len(listed) > 5 else ""
        return (
            f"{NOT_PASSED_THROUGH}, since they may show or name the person: {', '.join(listed[:5])}{more};"
            " --passthrough-images carries all topics over."
        )
