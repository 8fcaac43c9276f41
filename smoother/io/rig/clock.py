"""Sources of clocks as files: tables of receptions read, a simulated session's files written.

Sound tracks: a WAV file, or an audio topic of an MCAP recording.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.clock import Receptions

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import Recording
from ...runtime.inputs import check_input
from ...runtime.outputs import writing_folder
from ..mcap.messages import McapMessage
from ..recording.write import write_recording
from ..tables.columns import read_exact
from ..wire.schemas import parsed
from .images import decoded_messages
from .panel import check_folder

_AUDIO = "foxglove.RawAudio"
#: Blocks whose stamps lie farther from the even tick than this part of a block begin a new track.
JUMP_PART = 0.5
#: Stamp (s), samples (n, channels) and rate (Hz) of a message.
Block = tuple[float, FloatArray, float]


@dataclass(frozen=True)
class Track:
    """Sound without a gap."""

    samples: FloatArray  # (N,): the loudest channel, full scale 1
    rate_hz: float  # Samples per second, as measured by the stamps where there are several
    start_s: float  # Time of the first sample: 0 for a WAV file, on the recorder's clock for a topic
    source: str  # File, and topic where there is one


def read_sound(
    path: str | os.PathLike[str],
    topic: str | None = None,
    notes: list[str] | None = None,
) -> list[Track]:
    """The tracks of a WAV file, or of the audio topic of an MCAP file."""
    path = Path(path)
    if path.suffix.lower() == ".mcap":
        return _from_mcap(path, topic, [] if notes is None else notes)
    from scipy.io import wavfile

    check_input(path, RecordingError)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # chunks that it does not know are of no concern
            rate, data = wavfile.read(path)
    except FileNotFoundError as error:
        raise RecordingError(f"{path} does not exist; check the name.") from error
    except Exception as error:  # whatever a damaged file leads the library into
        raise RecordingError(
            f"{path} is not a WAV file that can be read ({' '.join(str(error).split())}); save it as"
            " 16-bit PCM."
        ) from error
    if not len(data) or rate <= 0:
        raise RecordingError(f"{path} has no sound; record it again.")
    return [Track(_loudest(_full_scale(data)), float(rate), 0.0, str(path))]


def _full_scale(data: np.ndarray) -> FloatArray:
    """Samples (N, channels) of any PCM type as floats between -1 and 1."""
    values = data.reshape(len(data), -1).astype(np.float64)
    if not np.issubdtype(data.dtype, np.integer):
        return np.nan_to_num(values)
    return (values - 128.0) / 128.0 if data.dtype == np.uint8 else values / float(np.iinfo(data.dtype).max)


def _loudest(values: FloatArray) -> FloatArray:
    return np.ascontiguousarray(values[:, int(np.argmax(values.var(axis=0)))])


def _from_mcap(path: Path, wanted: str | None, notes: list[str]) -> list[Track]:
    blocks: dict[str, list[Block]] = {}
    for topic, block in decoded_messages(path, lambda t: t.schema == _AUDIO, _block, "sound", notes):
        blocks.setdefault(topic, []).append(block)
    chosen = [name for name in blocks if wanted is None or wanted in name]
    if len(chosen) != 1:
        has = ", ".join(sorted(blocks)) or "none"
        what = "has no audio topic that can be read" if not chosen else "has several audio topics"
        raise RecordingError(
            f"{path} {what} (foxglove.RawAudio); found: {has}; name one with"
            " --audio-topic, or give a WAV file."
        )
    (name,) = chosen
    return _tracks([block for block in blocks[name] if len(block[1])], f"{path}, {name}")


def _block(message: McapMessage) -> Iterator[tuple[str, Block]]:
    """The topic and the block of one message."""
    audio = parsed(_AUDIO, message.data)
    if audio.format != "pcm-s16" or not audio.sample_rate or not audio.number_of_channels:
        raise RecordingError(f"{message.topic.name} is of format {audio.format!r}; record pcm-s16.")
    stamp = audio.timestamp.seconds + 1e-9 * audio.timestamp.nanos
    count = len(audio.data) // (2 * audio.number_of_channels)
    data = np.frombuffer(audio.data, "<i2", count * audio.number_of_channels)
    values = data.reshape(count, audio.number_of_channels) / 32767.0
    yield message.topic.name, (stamp or 1e-9 * message.log_ns, values, float(audio.sample_rate))


def _tracks(blocks: list[Block], source: str) -> list[Track]:
    """Blocks put together to runs whose stamps keep step; a run's stamps are averaged to one start."""
    runs: list[list[Block]] = []
    count = 0
    for block in blocks:
        stamp, samples, rate = block
        first_s, _, own_rate = runs[-1][0] if runs else (np.inf, None, rate)
        away_s = abs(stamp - first_s - count / rate)
        if rate != own_rate or away_s > max(JUMP_PART * len(samples) / rate, 0.05):
            runs.append([])
            count = 0
        runs[-1].append(block)
        count += len(samples)
    tracks: list[Track] = []
    for part in runs:
        stamps, parts, (rate, *_) = zip(*part, strict=True)
        starts = np.cumsum([0, *map(len, parts[:-1])]) / rate
        offset = np.array(stamps) - starts
        slope, level = 0.0, float(np.median(offset))
        if len(part) >= 20:  # the sound card's crystal against the recorder's clock
            slope, level = np.polyfit(starts, offset, 1)
            slope = slope if abs(slope) < 1e-3 else 0.0
        tracks.append(Track(_loudest(np.concatenate(parts)), rate / (1 + slope), float(level), source))
    if not tracks:
        raise RecordingError(f"{source} has no sound; record it again.")
    return tracks


COLUMNS = ("round", "node", "t_s")


def read_broadcast(path: str | os.PathLike[str], resolution_s: float) -> Receptions:
    """Read who received which broadcast when."""
    path = Path(path)
    numbers, texts = read_exact(path, COLUMNS, words=COLUMNS[:2], empty=COLUMNS[2:])
    rounds: dict[str, int] = {}
    rows: dict[tuple[int, str], tuple[int, float]] = {}  # row and time by round and node
    received = zip(texts["round"], texts["node"], numbers["t_s"].tolist(), strict=True)
    for row, (of_round, name, time) in enumerate(received, 1):
        if not name or not of_round:
            raise RecordingError(f"{path}, row {row}: round, node and a time in seconds are needed.")
        if np.isnan(time):
            continue  # not received
        first, _ = rows.setdefault((rounds.setdefault(of_round, len(rounds)), name), (row, time))
        if first != row:
            raise RecordingError(
                f"{path}, row {row}: {name} has a second time in round {of_round} (the first is in row"
                f" {first}); keep the first reception of each round."
            )
    names = [name for _, name in rows]
    if len(set(names)) < 2:
        raise RecordingError(f"{path} contains the times of {len(set(names))} node; two or more are needed.")
    event, times = np.array([number for number, _ in rows], np.int64), np.array([t for _, t in rows.values()])
    sigma = np.full(len(rows), resolution_s / np.sqrt(12))  # stamps are rounded to their step
    return Receptions(event, names, times, sigma, f"broadcast {path.name}")


SOUND, TIMES, MOTION, TRUTH = "beep.wav", "times.csv", "session.mcap", "truth.toml"
#: Largest sample of 16 bits that is written.
_LOUDEST = 30000


def write_clock_folder(
    path: str | os.PathLike[str],
    sound: FloatArray,  # (n,)
    sound_rate_hz: int,
    receptions: Receptions,
    recording: Recording,
    truth: str,
    *,
    force: bool = False,
) -> None:
    """Write what `calibrate clock` reads, and what it should find."""
    from scipy.io import wavfile

    rows = zip(receptions.event.tolist(), receptions.node, receptions.t_s.tolist(), strict=True)
    check_folder(Path(path), force)
    with writing_folder(path) as folder:
        wavfile.write(folder / SOUND, sound_rate_hz, np.rint(_LOUDEST * sound).astype(np.int16))
        lines = [",".join(COLUMNS), *(f"{event},{node},{t:.7f}" for event, node, t in rows), ""]
        (folder / TIMES).write_text("\n".join(lines), encoding="utf-8")
        write_recording(recording, folder / MOTION)
        (folder / TRUTH).write_text(truth, encoding="utf-8")
