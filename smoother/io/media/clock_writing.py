"""A simulated session's sources of clocks as files: a WAV, a table of receptions, a recording."""

from __future__ import annotations

import os

import numpy as np

from calib.clock.links import Receptions

from ...array_types import FloatArray
from ...recording import Recording
from ..plain.clock_times import COLUMNS
from ..recording.write import write_recording
from .panel_writing import writing_folder

SOUND, TIMES, MOTION, TRUTH = "beep.wav", "times.csv", "session.mcap", "truth.toml"
#: Largest sample of 16 bits that is written.
_LOUDEST = 30000


def write_clock_folder(
    path: str | os.PathLike[str],
    sound: FloatArray,
    sound_rate_hz: int,
    receptions: Receptions,
    recording: Recording,
    truth: str,
    *,
    force: bool = False,
) -> None:
    """Write what `calibrate clock` reads, and what it should find.

    Parameters
    ----------
    path : path-like
        The folder; it appears only when it is whole.
    sound : ndarray, shape (n,)
        Samples between -1 and 1.
    sound_rate_hz : int, Hz
        Of the sound.
    receptions : Receptions
        Who received which broadcast when.
    recording : Recording
        An arm in motion.
    truth : str
        TOML.
    force : bool
        Replace a folder that a simulation wrote.

    Raises
    ------
    UnoccludeError
        See `writing_folder`.
    """
    from scipy.io import wavfile

    rows = zip(receptions.event.tolist(), receptions.node, receptions.t_s.tolist(), strict=True)
    with writing_folder(path, force) as folder:
        wavfile.write(folder / SOUND, sound_rate_hz, np.rint(_LOUDEST * sound).astype(np.int16))
        lines = [",".join(COLUMNS), *(f"{event},{node},{t:.7f}" for event, node, t in rows), ""]
        (folder / TIMES).write_text("\n".join(lines), encoding="utf-8")
        write_recording(recording, folder / MOTION)
        (folder / TRUTH).write_text(truth, encoding="utf-8")
