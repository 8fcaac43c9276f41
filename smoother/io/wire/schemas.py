"""Our own protobuf messages, and the schemas that an MCAP file carries.

`unocclude.proto` is read when it is first needed, by a parser that knows just what that file
uses, so that neither a compiler nor generated code has to be kept.
"""

from __future__ import annotations

import re
from functools import cache
from importlib import import_module
from importlib.resources import files
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_SCALARS = {
    "double": descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
    "string": descriptor_pb2.FieldDescriptorProto.TYPE_STRING,
    "bool": descriptor_pb2.FieldDescriptorProto.TYPE_BOOL,
    "uint32": descriptor_pb2.FieldDescriptorProto.TYPE_UINT32,
}


@cache
def message_class(name: str) -> Any:
    """Class of a message by its full name, such as `unocclude.Imu` or `foxglove.Odometry`."""
    package, _, short = name.rpartition(".")
    if package == "foxglove":
        return getattr(import_module(f"foxglove_schemas_protobuf.{short}_pb2"), short)
    _load_own()
    return message_factory.GetMessageClass(descriptor_pool.Default().FindMessageTypeByName(name))


@cache
def schema_data(name: str) -> bytes:
    """The serialised FileDescriptorSet of a message with all it builds on, as MCAP wants it."""
    descriptors = descriptor_pb2.FileDescriptorSet()
    seen: set[str] = set()

    def add(file: Any) -> None:
        if file.name in seen:
            return
        seen.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(descriptors.file.add())

    add(message_class(name).DESCRIPTOR.file)
    return descriptors.SerializeToString(deterministic=True)


@cache
def _load_own() -> None:
    for dependency in ("Point3", "Vector3"):
        import_module(f"foxglove_schemas_protobuf.{dependency}_pb2")
    import_module("google.protobuf.timestamp_pb2")
    text = files(__package__).joinpath("unocclude.proto").read_text(encoding="utf-8")
    descriptor_pool.Default().AddSerializedFile(_parse(text).SerializeToString())


def _parse(text: str) -> descriptor_pb2.FileDescriptorProto:
    """Descriptor of a flat proto3 file: top-level enums and messages, scalar and named types."""
    text = re.sub(r"//[^\n]*", "", text)
    package = re.search(r"package\s+(\w+);", text)
    assert package is not None
    file = descriptor_pb2.FileDescriptorProto(
        name="unocclude/unocclude.proto", package=package[1], syntax="proto3"
    )
    file.dependency.extend(re.findall(r'import\s+"([^"]+)";', text))
    for name, body in re.findall(r"enum\s+(\w+)\s*{(.*?)}", text, re.DOTALL):
        enum = file.enum_type.add(name=name)
        for value, number in re.findall(r"(\w+)\s*=\s*(\d+);", body):
            enum.value.add(name=value, number=int(number))
    enums = {enum.name for enum in file.enum_type}
    for name, body in re.findall(r"message\s+(\w+)\s*{(.*?)}", text, re.DOTALL):
        message = file.message_type.add(name=name)
        for repeated, kind, field_name, number in re.findall(
            r"(repeated\s+)?([\w.]+)\s+(\w+)\s*=\s*(\d+);", body
        ):
            field = message.field.add(name=field_name, number=int(number))
            field.label = field.LABEL_REPEATED if repeated else field.LABEL_OPTIONAL
            if kind in _SCALARS:
                field.type = _SCALARS[kind]
            else:
                field.type = field.TYPE_ENUM if kind in enums else field.TYPE_MESSAGE
                field.type_name = f".{kind}" if "." in kind else f".{file.package}.{kind}"
    return file
