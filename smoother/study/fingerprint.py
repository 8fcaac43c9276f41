"""What a result depends on, as hashes: input, configuration, calibration, version."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from typing import Any

from ..config import Config
from ..io.recording.selection import Selection
from ..runtime.inputs import check_input

_BLOCK = 1 << 20


@dataclass(frozen=True)
class InputSelection:
    """What to take of a recording that has several of it, and what to carry over; see `smooth --help`."""

    imu: str | None = None
    skeleton: str | None = None
    side: str | None = None
    body: int | None = None
    passthrough_images: bool = False

    @property
    def selection(self) -> Selection:
        """What to take, as readers want it."""
        return Selection(imu=self.imu, skeleton=self.skeleton, side=self.side, body=self.body)


def file_hash(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits; refuses what is no file."""
    check_input(path)
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def config_hash(config: Config, choice: InputSelection) -> str:
    """SHA-256 of all settings that a result depends on; the number of processes is none of them."""
    settings: dict[str, Any] = config.model_dump(mode="json", exclude={"windows": {"processes"}})
    return text_hash(json.dumps([settings, asdict(choice)], sort_keys=True))


def text_hash(*texts: str) -> str:
    """SHA-256 of texts, told apart."""
    return hashlib.sha256("\0".join(texts).encode("utf-8", "surrogateescape")).hexdigest()


def row_id(name: str, input_hash: str, config: str, calibration: str, version: str) -> str:
    """What a result is known by: the same id, the same result."""
    return text_hash(name, input_hash, config, calibration, version)[:32]
