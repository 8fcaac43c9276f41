"""The messages that are compiled and the file that describes them."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from smoother.io.wire.schemas import message_class, schema_data

FOLDER = files("smoother.io.wire")
#: A message of each file.
FILES = {
    "unocclude": "unocclude.Imu",
    "unocclude_draws": "unocclude.Draws",
    "unocclude_pixels": "unocclude.Keypoints2D",
}
SCALARS = {1: "double", 6: "fixed64", 8: "bool", 9: "string", 12: "bytes", 13: "uint32"}


@pytest.mark.parametrize("name", FILES)
def test_the_compiled_messages_are_those_of_the_file(name: str):
    text = re.sub(r"//[^\n]*", "", FOLDER.joinpath(f"{name}.proto").read_text(encoding="utf-8"))
    file = message_class(FILES[name]).DESCRIPTOR.file
    described = {}
    for kind, name, body in re.findall(r"(enum|message)\s+(\w+)\s*{(.*?)}", text, re.DOTALL):
        pattern = r"(\w+)\s*=\s*(\d+);" if kind == "enum" else r"(repeated )?([\w.]+)\s+(\w+)\s*=\s*(\d+);"
        described[name] = re.findall(pattern, body)
    compiled: dict[str, list[tuple[str, ...]]] = {
        name: [(value.name, str(value.number)) for value in enum.values]
        for name, enum in file.enum_types_by_name.items()
    }
    for name, message in file.message_types_by_name.items():
        compiled[name] = []
        for field in message.fields:
            kind = field.message_type or field.enum_type
            kind = SCALARS[field.type] if kind is None else kind.full_name.removeprefix("unocclude.")
            repeated = "repeated " if field.is_repeated else ""
            compiled[name].append((repeated, kind, field.name, str(field.number)))
    assert compiled == described
    assert file.package == "unocclude" and "package unocclude;" in text
    assert [each.name for each in file.dependencies] == re.findall(r'import "(.*)";', text)


@pytest.mark.parametrize("name", FILES)
def test_protoc_makes_the_same(tmp_path: Path, name: str):
    protoc = pytest.importorskip("grpc_tools.protoc")
    (tmp_path / "foxglove").write_bytes(schema_data("foxglove.SceneUpdate"))
    command = [
        "protoc",
        f"--descriptor_set_in={tmp_path / 'foxglove'}",
        f"-Iunocclude={FOLDER}",
    ]
    assert protoc.main([*command, f"-o{tmp_path / 'out'}", f"unocclude/{name}.proto"]) == 0
    (made,) = FileDescriptorSet.FromString((tmp_path / "out").read_bytes()).file
    for message in made.message_type:
        for field in message.field:
            field.ClearField("json_name")
    assert made.SerializeToString() == message_class(FILES[name]).DESCRIPTOR.file.serialized_pb


def test_a_schema_has_all_it_builds_on_before_it():
    names = [file.name for file in FileDescriptorSet.FromString(schema_data("unocclude.Skeleton")).file]
    assert names[-1] == "unocclude/unocclude.proto"
    assert set(names[:-1]) == {
        "foxglove/Point3.proto",
        "foxglove/Vector3.proto",
        "google/protobuf/timestamp.proto",
    }
