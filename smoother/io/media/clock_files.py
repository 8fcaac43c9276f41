"""Sources of clocks as files: tables of receptions read, a simulated session's files written."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np

from calib.clock.links import Receptions

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import Recording
from ...runtime.inputs import check_input
from ..recording.write import write_recording
from .panel_writing import writing_folder

COLUMNS = ("round", "node", "t_s")
#: Times that say "not received", in lower case.
MISSED = ("", "nan", "na", "n/a", "none", "null", "-")


def read_broadcast(path: str | os.PathLike[str], resolution_s: float) -> Receptions:
    """Read who received which broadcast when.

    A node that missed a round has no row for it, or a time that is empty or one of `MISSED`.

    Parameters
    ----------
    path : path-like
        CSV with the columns round (any name), node, t_s (s on that node's clock).
    resolution_s : float, s
        Step of the nodes' stamps.

    Returns
    -------
    Receptions
        A row a reception, with the standard deviation of a rounded stamp.

    Raises
    ------
    RecordingError
        The file cannot be read, lacks a column, or a line of it is wrong; the message names the line.
    """
    path = Path(path)
    check_input(path, RecordingError)
    rounds: dict[str, int] = {}
    line_of: dict[tuple[int, str], int] = {}
    event, node, t = [], [], []
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            rows = csv.DictReader(stream, skipinitialspace=True)
            missing = [name for name in COLUMNS if name not in (rows.fieldnames or [])]
            if missing:
                raise RecordingError(
                    f"{path} lacks the column {', '.join(missing)}; its first line must be round,node,t_s."
                )
            for row in rows:
                line = rows.line_num
                name, text = (row["node"] or "").strip(), (row["t_s"] or "").strip()
                if text.lower() in MISSED and name:
                    continue  # not received
                try:
                    time = float(text)
                except ValueError:
                    time = float("nan")
                if not name or not np.isfinite(time) or not (row["round"] or "").strip():
                    raise RecordingError(
                        f"{path}, line {line}: round, node and a time in seconds are needed."
                    )
                number = rounds.setdefault(row["round"].strip(), len(rounds))
                if (number, name) in line_of:
                    raise RecordingError(
                        f"{path}, line {line}: {name} has a second time in round {row['round'].strip()} (the"
                        f" first is in line {line_of[number, name]}); keep the first reception of each round."
                    )
                line_of[number, name] = line
                event.append(number)
                node.append(name)
                t.append(time)
    except FileNotFoundError as error:
        raise RecordingError(f"{path} does not exist; check the name.") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path} cannot be read as CSV: {error}.") from error
    if len(set(node)) < 2:
        raise RecordingError(f"{path} holds the times of {len(set(node))} node; two or more are needed.")
    sigma = np.full(len(t), resolution_s / np.sqrt(12))  # stamps are rounded to their step
    return Receptions(np.array(event, dtype=np.int64), node, np.array(t), sigma, f"broadcast {path.name}")


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
