"""Axivity AX6 (and AX3): binary CWA files of OmGui."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...units import STANDARD_GRAVITY
from ..tables.file_head import amount
from ..tables.protocol import FileHead, ImuTable

#: A data block: 512 bytes, little-endian (Open Movement, "AX3/AX6 technical documentation", CWA data blocks).
_BLOCK = np.dtype(
    [
        ("mark", "S2"),
        ("length", "<u2"),
        ("fraction", "<u2"),
        ("session", "<u4"),
        ("sequence", "<u4"),
        ("time", "<u4"),
        ("light", "<u2"),
        ("temperature", "<u2"),
        ("events", "u1"),
        ("battery", "u1"),
        ("rate", "u1"),
        ("axes", "u1"),
        ("offset", "<i2"),
        ("count", "<u2"),
        ("data", "<i2", 240),
        ("checksum", "<u2"),
    ]
)
#: Gyroscope's range where the block states none, deg/s.
_USUAL_RANGE = 2000.0


class Axivity:
    """Gyroscope in deg/s and accelerometer in g, 16 bits, in blocks with a time stamp each."""

    key = "axivity"
    title = "Axivity AX6 (CWA)"
    kind = "imu"
    recognised_by = "a binary header that begins with MD, and blocks that begin with AX"

    def recognises(self, head: FileHead) -> bool:
        """Whether the file begins as a CWA file does; never raises."""
        return head.raw[:4] == b"MD\xfc\x03" or head.raw[:4] == b"AX\xfc\x01"

    def read(self, path: Path) -> list[ImuTable]:
        """A table a sensor: see `DeviceFormat.read`.

        Raises
        ------
        RecordingError
            There are no blocks of samples, or they hold no gyroscope.
        """
        try:
            raw = path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
        blocks = np.frombuffer(raw, _BLOCK, count=len(raw) // _BLOCK.itemsize)
        data = blocks[(blocks["mark"] == b"AX") & (blocks["length"] == 508)]
        whole = (
            (data["axes"] & 15 == 2)
            & (data["axes"] >> 4 == 6)
            & (data["count"] * 6 <= 240)
            & (data["count"] > 0)
        )
        intact = _sums(data) == 0
        usable = data[whole & intact]
        if not len(usable):
            axes = int(data["axes"][0] >> 4) if len(data) else 0
            what = f"holds {axes} axes, no gyroscope" if axes == 3 else "holds no intact blocks of samples"
            raise RecordingError(
                f"{path} is an {self.title} that {what}; set up an AX6 with its gyroscope on, and download"
                " it again."
            )
        cut = len(raw) % _BLOCK.itemsize != 0
        return [_table(usable, len(data) - len(usable), cut)]


def _table(blocks: NDArray[np.void], left_out: int, cut: bool) -> ImuTable:
    """Samples of intact blocks with six axes."""
    # A sample stands in the rows of its block that are filled.
    filled = np.arange(40) < blocks["count"][:, None]
    values = blocks["data"].reshape(-1, 40, 6).astype(float)
    light = blocks["light"].astype(int)
    per_g = (1 << (8 + (light >> 13))).astype(float)
    code = (light >> 10) & 7
    full_scale = np.where(code > 0, 8000.0 / (1 << code), _USUAL_RANGE)
    gyro = values[:, :, :3] * (full_scale / 32768 * np.pi / 180)[:, None, None]
    acc = values[:, :, 3:] * (STANDARD_GRAVITY / per_g)[:, None, None]
    rate = 3200.0 / (1 << (15 - (blocks["rate"] & 15).astype(int)))
    t_s = _starts(blocks, rate)[:, None] + np.arange(40) / rate[:, None]
    notes = [f"{amount(left_out, 'damaged block was', 'damaged blocks were')} left out."] if left_out else []
    if cut:  # a file is a whole number of blocks
        notes.append("The file is cut off within a block; what is behind it is lost. Download it again.")
    return ImuTable(
        name="",
        t_s=_even(t_s, blocks)[filled],
        acc=acc[filled],
        gyro=gyro[filled],
        units="g, deg/s",
        notes=notes,
    )


def _starts(blocks: NDArray[np.void], rate: FloatArray) -> FloatArray:
    """Time of each block's first sample, s since 1970 on the device's clock."""
    stamp = blocks["time"].astype(np.int64)
    year, month, day = 2000 + (stamp >> 26), (stamp >> 22) & 15, (stamp >> 17) & 31
    hour, minute, second = (stamp >> 12) & 31, (stamp >> 6) & 63, stamp & 63
    months = (year - 1970) * 12 + np.clip(month, 1, 12) - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + day - 1
    whole = days * 86_400 + hour * 3600 + minute * 60 + second
    # A fraction is there where its top bit is set; the offset then counts the fraction's whole samples too.
    fractional = np.where(blocks["fraction"] & 0x8000, (blocks["fraction"].astype(np.int64) & 0x7FFF) << 1, 0)
    offset = blocks["offset"] + ((fractional * rate.astype(np.int64)) >> 16)
    return whole + fractional / 65536 - offset / rate


def _even(t_s: FloatArray, blocks: NDArray[np.void]) -> FloatArray:
    """Times (blocks, 40); samples are spread up to the next block where it follows at once."""
    count = blocks["count"].astype(int)
    starts, tick = t_s[:, 0], t_s[:, 1] - t_s[:, 0]
    follows = np.zeros(len(blocks), bool)
    length = np.diff(starts)
    # The crystal differs from its nominal rate by a few percent at most; a longer step is a pause.
    follows[:-1] = (np.diff(blocks["sequence"].astype(np.int64)) == 1) & (
        np.abs(length / (count[:-1] * tick[:-1]) - 1) < 0.1
    )
    tick[:-1] = np.where(follows[:-1], length / count[:-1], tick[:-1])
    return starts[:, None] + np.arange(40) * tick[:, None]


def _sums(blocks: NDArray[np.void]) -> NDArray[np.uint16]:
    """Sums of each block's 16-bit words: 0 where its checksum is right."""
    if not len(blocks):
        return np.zeros(0, np.uint16)
    words = np.ascontiguousarray(blocks).view("<u2").reshape(len(blocks), 256)
    return words.sum(axis=1, dtype=np.uint64).astype(np.uint16)
