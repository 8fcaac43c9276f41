"""A result as a recording of Rerun, with the views that show it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...recording import Truth
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ...runtime.outputs import writing
from ...runtime.packages import extra_module
from ..result.world import common_down, world_axes
from .rerun_arm import RerunArm
from .rerun_layout import views


def rerun_module() -> ModuleType:
    """The package `rerun`, an extra.

    Raises
    ------
    UnoccludeError
        It is not installed, or too old; the sentence says how to get it.
    """
    return extra_module("rerun", "rerun-sdk", "view", ["StateChange"], ["blueprint"])


def check_rrd(recoveries: Sequence[Recovery]) -> None:
    """Refuse what could not be shown, before any work is done for it.

    Raises
    ------
    UnoccludeError
        rerun-sdk is not installed, or no arm has an answer at any time.
    """
    rerun_module()
    if not any(recovery.answered.any() for recovery in recoveries):
        raise UnoccludeError(f"{recoveries[0].name}: there is no answer at any time, and nothing to show")


def write_rrd(
    recoveries: Sequence[Recovery],
    path: str | os.PathLike[str],
    *,
    truths: Sequence[Truth | None] | None = None,
    level_down: FloatArray | None = None,
    force: bool = False,
) -> None:
    """Write all arms of a result into one file of Rerun.

    Parameters
    ----------
    recoveries : sequence of Recovery
        One for each arm, of one camera.
    path : path-like
        The file to write.
    truths : sequence of Truth or None, optional
        For each arm, times counted from its origin.
    level_down : ndarray, shape (3,), optional
        Down in the camera's axes if the camera stands level, where no arm's method found gravity. Without
        either the picture stands in the camera's axes.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        rerun-sdk is not installed, no arm has an answer, the file exists and `force` is not given, or it
        cannot be written.
    """
    rr = rerun_module()
    results = list(recoveries)
    check_rrd(results)
    down = common_down(results, level_down)
    R_W_K = np.eye(3) if down is None else world_axes(down)
    arms = [
        RerunArm(rr, recovery, name, truth, number if len(results) > 1 else None)
        for number, (recovery, name, truth) in enumerate(
            zip(results, _names(results), truths or [None] * len(results), strict=True)
        )
    ]
    with writing(path, force) as temporary:
        stream = rr.RecordingStream("unocclude", recording_id=_identity(results), send_properties=False)
        stream.save(str(temporary), default_blueprint=views(rr, arms, R_W_K, upright=down is not None))
        stream.send_recording_name(results[0].name)
        upright = rr.ViewCoordinates.RIGHT_HAND_Z_UP
        if down is not None:
            stream.log("scene", upright, static=True)
        stream.log("scene/camera", rr.Transform3D(mat3x3=R_W_K), static=True)
        stream.log("notes", rr.TextDocument(_notes(results), media_type="text/markdown"), static=True)
        for arm in arms:
            arm.log(stream)
        stream.flush()
        stream.disconnect()


def _names(recoveries: Sequence[Recovery]) -> list[str]:
    """Side of each arm, with a number where sides do not tell them apart."""
    sides = [recovery.side or "arm" for recovery in recoveries]
    return [side if sides.count(side) == 1 else f"{side}_{number + 1}" for number, side in enumerate(sides)]


def _identity(recoveries: Sequence[Recovery]) -> str:
    """The same for the same recording: Rerun shows a file that was made anew in place of the older one."""
    text = "|".join(f"{each.name} {each.side} {each.origin_ns} {len(each)}" for each in recoveries)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _notes(recoveries: Sequence[Recovery]) -> str:
    lines = []
    for recovery in recoveries:
        side = f"{recovery.side} arm, " if recovery.side else ""
        lines += [f"### {recovery.name}: {side}{recovery.method}", recovery.estimates.verdict]
        lines += [f"- Not to be trusted: {each}" for each in untrusted_sentences(recovery)]
        if (check := recovery.estimates.self_check) is not None:
            lines.append(check.sentence)
        lines += [f"- {note}" for note in recovery.notes]
    lines.append("Blue: the camera saw the forearm. Orange: recovered. Grey: the camera's own joints.")
    lines.append("Dark red: the answer is not to be trusted.")
    lines.append("Green: the truth, where there is one. Ellipsoid: 2 sigma. Trail: 2 s.")
    return "\n\n".join(line for line in lines if line)
