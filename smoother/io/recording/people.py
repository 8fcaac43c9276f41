"""The arms of a file person by person: numbers that the camera exchanged or gave anew are put right."""

from __future__ import annotations

from dataclasses import replace

from ...runtime.store import Store
from .bodies import join_bodies
from .body_agreement import WornImus
from .body_swaps import unswap_bodies
from .streams import ArmFrames, RecordingFile


def people(file: RecordingFile, store: Store | None = None) -> tuple[list[ArmFrames], list[str]]:
    """The arms of every person, each under one number.

    Parameters
    ----------
    file : RecordingFile
        All streams; it stays as it is.
    store : Store, optional
        Where the positions of changed arms are to lie; None = in memory.

    Returns
    -------
    arms : list of ArmFrames
    notes : list of str
        A sentence for each change.
    """
    arms, swapped = unswap_bodies(file.arms, store)
    arms, joined = join_bodies(arms, store, WornImus(replace(file, arms=arms), store))
    return arms, swapped + joined
