r"""Our own protobuf messages, and the schemas that an MCAP file carries.

`unocclude_pb2.py` is what protoc makes of `unocclude.proto`, and likewise of the other `.proto` files beside
it; whoever changes such a file makes its module anew, with grpcio-tools 1.68 (a newer one would ask for a
newer protobuf than we do)::

    python -c 'import sys; from smoother.io.wire.schemas import schema_data
    sys.stdout.buffer.write(schema_data("foxglove.SceneUpdate"))' > /tmp/foxglove
    python -m grpc_tools.protoc --descriptor_set_in=/tmp/foxglove -Iunocclude=smoother/io/wire \
        --python_out=/tmp unocclude/unocclude.proto
    sed 's/^from foxglove /from foxglove_schemas_protobuf /' /tmp/unocclude/unocclude_pb2.py \
        > smoother/io/wire/unocclude_pb2.py
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from google.protobuf import descriptor_pb2

#: Modules of the messages that have a file of their own.
_MODULES = dict.fromkeys(("Keypoint", "Keypoints2D"), "unocclude_pixels_pb2")


@cache
def message_class(name: str) -> Any:
    """Class of a message by its full name, such as `unocclude.Imu` or `foxglove.Odometry`."""
    package, _, short = name.rpartition(".")
    module = f"foxglove_schemas_protobuf.{short}_pb2"
    if package != "foxglove":
        module = f"{__package__}.{_MODULES.get(short, 'unocclude_pb2')}"
    return getattr(import_module(module), short)


def parsed(name: str, data: bytes) -> Any:
    """A message of its bytes."""
    from google.protobuf.message import DecodeError

    try:
        return message_class(name).FromString(data)
    except DecodeError as error:
        raise ValueError(f"a damaged message of {name}") from error


@cache
def schema_data(name: str) -> bytes:
    """The serialised FileDescriptorSet of a message with all it builds on, as MCAP wants it."""
    descriptors = descriptor_pb2.FileDescriptorSet()
    names: set[str] = set()

    def add(file: Any) -> None:
        if file.name in names:
            return
        names.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(descriptors.file.add())

    add(message_class(name).DESCRIPTOR.file)
    return descriptors.SerializeToString(deterministic=True)
