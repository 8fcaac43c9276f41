"""Outputs as text that can be compared and shown: texts themselves, other files as lines of digests.

An MCAP is one line per message (topic, times, digest) with its schemas, metadata and chunks; a Parquet file a
line a column; a zip its members; anything else a line for each 64 bytes, or block, of its bytes. A file of
another kind goes into `KINDS`, by its ending.
"""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

from smoother import __version__

#: Lines that are longer are broken after commas, brackets and semicolons, so that a difference can be shown.
LONG_LINE = 300
#: Bytes that a line of any other file represents, where the file has no more than SMALL bytes; else a block.
_ROW, _SMALL, _BLOCK = 64, 1 << 16, 1 << 12
#: Columns of Parquet files that contain times of the wall or figures of the machine, in studies.
MASKED_COLUMNS = re.compile(
    r"(^|_)(input_place|input_state|output_mtime_ns|finished|started|seconds|cpu_s|elapsed_s|took_s|memory|peak\w*)(_|$)"
)


def digest(data: bytes) -> str:
    """First digits of the SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def rendering(path: Path, folder: Path) -> str:
    """A file as text, without what changes from run to run."""
    return rendered(path.name, path.read_bytes(), folder)


def rendered(name: str, data: bytes, folder: Path) -> str:
    """As `rendering`, of bytes with a name."""
    kind = KINDS.get(Path(name).suffix.lower())
    if kind is not None:
        try:
            return masked("\n".join(kind(data, folder)) + "\n", folder)
        except Exception as error:  # a damaged file, which a command may well leave
            return f"unreadable: {type(error).__name__}\n" + "\n".join(_bytes(data)) + "\n"
    if b"\0" not in data[:8192]:
        try:
            return masked(broken_lines(data.decode("utf-8")), folder)
        except UnicodeDecodeError:
            pass
    return "\n".join(_bytes(data)) + "\n"


def broken_lines(text: str) -> str:
    """The text with long lines broken; no character is lost, and line ends stay what they were."""
    if "\r" in text:
        text = text.replace("\r", "\\r")
    lines = text.split("\n")
    return "\n".join(
        re.sub(r"([,;>}\]])(?=.)", "\\1\n", line) if len(line) > LONG_LINE else line for line in lines
    )


def _bytes(data: bytes) -> Iterator[str]:
    size = _ROW if len(data) <= _SMALL else _BLOCK
    yield f"{len(data)} bytes, {hashlib.sha256(data).hexdigest()}"
    for start in range(0, len(data), size):
        yield f"from {start:#08x}: {digest(data[start : start + size])}"


def _mcap(data: bytes, folder: Path) -> Iterator[str]:
    """Records in the file's order, but those with offsets and sums of others; then messages by topic."""
    from mcap import records
    from mcap.stream_reader import StreamReader

    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        match record:
            case records.Header():
                yield f"header {record.profile!r} {record.library!r}"
            case records.Chunk():
                times = f"{record.message_start_time} to {record.message_end_time}"
                packed = f"{record.compression!r} {record.uncompressed_size} bytes {digest(record.data)}"
                yield f"chunk {times} {packed}"
            case records.Metadata():
                yield f"metadata {record.name!r}"
                # as JSON has it, so that masks of versions and times hold; our values are JSON
                for key, value in record.metadata.items():
                    shown = value if value.startswith(('"', "[", "{")) else f'"{value}"'
                    yield broken_lines(f'    "{key}": {shown}')
            case records.Attachment():
                what = f"{record.media_type!r} {len(record.data)} bytes {digest(record.data)}"
                yield f"attachment {record.name!r} {record.log_time} {what}"
    by_topic: dict[str, list[str]] = {}
    names: dict[int, str] = {}
    for record in StreamReader(io.BytesIO(data)).records:
        match record:
            case records.Schema():
                line = f"schema {record.id} {record.name!r} {record.encoding} {digest(record.data)}"
                by_topic.setdefault("", []).append(line)
            case records.Channel():
                names[record.id] = record.topic
                about = f"schema {record.schema_id} {record.message_encoding} {record.metadata}"
                by_topic.setdefault(record.topic, []).append(f"topic {record.topic} {about}")
            case records.Message():
                times = f"{record.log_time} {record.publish_time} {record.sequence}"
                by_topic[names[record.channel_id]].append(
                    f"{names[record.channel_id]} {times} {digest(record.data)}"
                )
    for topic in sorted(by_topic):
        yield from by_topic[topic]


def _parquet(data: bytes, folder: Path) -> Iterator[str]:
    import pyarrow.parquet as parquet

    table = parquet.read_table(io.BytesIO(data))
    about = parquet.ParquetFile(io.BytesIO(data)).metadata
    yield f"{about.num_rows} rows in {about.num_row_groups} groups, format {about.format_version}"
    for key, value in sorted((about.metadata or {}).items()):
        if key != b"ARROW:schema":
            yield broken_lines(f"metadata {key.decode()}: {value.decode('utf-8', 'replace')}")
    for number, name in enumerate(table.column_names):
        column = table.column(number)
        values = "masked" if MASKED_COLUMNS.search(name) else ""
        if not values:
            texts = masked(repr(column.to_pylist()), folder)
            values = f"{digest(texts.encode())}, first {texts[1:100]}"
        packed = {about.row_group(group).column(number).compression for group in range(about.num_row_groups)}
        if len(table.schema) != about.num_columns:
            packed = set()  # nested columns have leaves of their own
        yield f"column {name} {column.type} {' '.join(sorted(packed))}: {values}"


def _zip(data: bytes, folder: Path) -> Iterator[str]:
    """Members by name; their dates are those of the clock."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for entry in archive.infolist():
            yield f"member {entry.filename}, compression {entry.compress_type}"
            yield rendered(entry.filename, archive.read(entry), folder)


#: By the ending: from the bytes and the folder to lines.
KINDS: dict[str, Callable[[bytes, Path], Iterator[str]]] = {
    ".mcap": _mcap,
    ".parquet": _parquet,
    ".zip": _zip,
    ".npz": _zip,
    ".xlsx": _zip,
}


PROJECT = Path(__file__).parents[2]
_VERSION = re.escape(__version__)
#: Patterns and their replacements, in this order; each names its source.
MASKS: tuple[tuple[str, str], ...] = (
    # `unocclude 0.1.0`, and the metadata of results and of JSON
    (rf"\bunocclude {_VERSION}", "unocclude VERSION"),
    (rf'("(?:version|unocclude)":\s*"){_VERSION}"', r'\1VERSION"'),
    # `live`: a line of the state whenever a second of the wall has passed
    (r"(?m)^ *\d+\.\d s  .*; step \d+\.\d ms; load \d+ %.*\n", ""),
    # figures of `live`, in JSON: how busy the computer was
    (r'("(?:load|step_ms|busy)":\s*)[-\d.e+]+', r"\1LOAD"),
    # how long something took, in JSON and in tables of `batch`
    (
        r'("(?:seconds|elapsed_s|took_s|cpu_s|finished|started|peak_memory_mb)":\s*)("[^"]*"|[-\d.e+]+)',
        r"\1TIME",
    ),
    # `batch`: how long it took, and where and when its inputs and the study itself came to be
    (r"\b(now in )[\d.]+ \w+, [\d.]+ times real time", r"\1TIME"),
    (r'("(?:input_place|input_state)":\s*)"[0-9a-f]{32}"', r'\1"PLACE"'),
    (r'("output_mtime_ns":\s*)\d+', r"\1MOMENT"),
    (r"\A[0-9a-f]{32}\s*\Z", "STUDY"),
    # files of a study's rows are called by the moment
    (r"\brows-\d+-[0-9a-f]+\.parquet", "rows-MOMENT.parquet"),
    # a date with a time, as ISO 8601 has it, of this century's twenties on the wall
    (r"\b20[2-9]\d-[01]\d-[0-3]\d[T ][0-2]\d:[0-5]\d(:[0-5]\d(\.\d+)?)?(Z|\+00:00)?", "MOMENT"),
)


def masked(text: str, folder: Path | None = None) -> str:
    """The text without what changes from run to run."""
    if folder is not None:
        for name in sorted({str(folder), str(folder.resolve())}, key=len, reverse=True):
            text = text.replace(name, "FOLDER")
    text = text.replace(str(PROJECT), "PROJECT")
    for pattern, instead in MASKS:
        text = re.sub(pattern, instead, text)
    return text
