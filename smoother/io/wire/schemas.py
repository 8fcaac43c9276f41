"""Protobuf messages by name: Foxglove's, and our own as the `.proto` files beside this one define them."""

from __future__ import annotations

import re
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

#: Our files in the order in which they are looked through.
_FILES = ("unocclude.proto", "unocclude_pixels.proto")
_BLOCK = re.compile(r"(enum|message) (\w+) \{(.*?)\}", re.DOTALL)
_FIELD = re.compile(r"(repeated )?(?:([\w.]+) )?(\w+) = (\d+);")


@cache
def message_class(name: str) -> Any:
    """Class of a message by its full name, such as `unocclude.Imu` or `foxglove.Odometry`."""
    package, _, short = name.rpartition(".")
    if package == "foxglove":
        return getattr(import_module(f"foxglove_schemas_protobuf.{short}_pb2"), short)
    _define_own()
    return message_factory.GetMessageClass(descriptor_pool.Default().FindMessageTypeByName(name))


@cache
def _define_own() -> None:
    """Make our own messages known; their files have comments, enums and messages with no others inside."""
    for name in _FILES:
        text = re.sub(r"//.*", "", Path(__file__).with_name(name).read_text(encoding="utf-8"))
        for of_other in re.findall(r'import "foxglove/(\w+)\.proto";', text):
            import_module(f"foxglove_schemas_protobuf.{of_other}_pb2")
        if "google/protobuf/timestamp" in text:
            import_module("google.protobuf.timestamp_pb2")
        file = descriptor_pb2.FileDescriptorProto(
            name=f"unocclude/{name}", package="unocclude", syntax="proto3"
        )
        file.dependency.extend(re.findall(r'import "([^"]+)";', text))
        blocks = _BLOCK.findall(text)
        enums = {block for kind, block, _ in blocks if kind == "enum"}
        for kind, block, body in blocks:
            if kind == "enum":
                values = [
                    {"name": value, "number": int(number)} for *_, value, number in _FIELD.findall(body)
                ]
                file.enum_type.add(name=block, value=values)
                continue
            message = file.message_type.add(name=block)
            for repeated, of, field, number in _FIELD.findall(body):
                each = message.field.add(name=field, number=int(number))
                each.label = each.LABEL_REPEATED if repeated else each.LABEL_OPTIONAL
                if of in ("string", "double", "uint32", "bool"):
                    each.type = getattr(each, f"TYPE_{of.upper()}")
                else:
                    each.type = each.TYPE_ENUM if of in enums else each.TYPE_MESSAGE
                    each.type_name = f".{of}" if "." in of else f".unocclude.{of}"
        descriptor_pool.Default().AddSerializedFile(file.SerializeToString())


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
