"""Device files: recognised and read, and what is made of them."""

from __future__ import annotations

from tools.fuzz.files import file_of


def any_device(data: bytes) -> None:
    """A file of any device, recognised by its content."""
    from smoother.io.devices.files import import_files
    from smoother.io.devices.folder import sort_files
    from smoother.io.devices.registry import FileReader

    path, reader = file_of(data, "export.csv"), FileReader()
    skeletons, imus, _ = sort_files([path], reader)
    import_files(skeletons, imus, reader=reader)


def one_device(key: str, data: bytes) -> None:
    """A file that the user says is of this device."""
    from smoother.io.devices.files import ImuFiles, import_files
    from smoother.io.devices.registry import FileReader, format_named
    from smoother.io.tables.protocol import ImuTable, SkeletonTable

    path, reader = file_of(data, "export.dat"), FileReader(key, key)
    tables = reader.read(path, format_named(key))
    skeletons = [path] if any(isinstance(table, SkeletonTable) for table in tables) else []
    imus = [ImuFiles((path,))] if any(isinstance(table, ImuTable) for table in tables) else []
    import_files(skeletons, imus, reader=reader)
