"""`unocclude match`: which IMU is on which body and limb."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from .options import Force, Json, RecordingPath, Skeleton
from .output import check_outputs, print_notes, print_table, say, write_json

if TYPE_CHECKING:
    from ..matching import ImuMatch

Method = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="motion|magnitudes|joint-likelihood|shakeid|acceleration-distance|all",
        help="How pairs are compared; `all` prints every method's answer beside the others.",
    ),
]
Reach = Annotated[
    float,
    typer.Option("--clocks-apart-s", metavar="S", min=0.0, max=60.0, help="Clocks may differ by this, s."),
]


def match(
    recording_file: RecordingPath,
    method: Method = "motion",
    clocks_apart_s: Reach = 5.0,
    skeleton: Skeleton = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Settle which IMU is on which body and limb, by motion alone.

    Needs no calibration, no common orientation and no common clock. An IMU is on the wrist (the forearm) or
    the upper arm of one body, on none of the limbs in view, or unknown where the motion does not settle it.
    """
    from ..io import open_recording
    from ..io.recording.match_file import match_file
    from ..matching import METHODS

    names = list(METHODS) if method == "all" else [method]
    if names[0] not in METHODS:
        raise typer.BadParameter(f"--method is {', '.join(METHODS)} or all, not '{method}'")
    check_outputs(force, [json_file], [recording_file])
    file = open_recording(recording_file, truth=False)
    answers = {}
    for name in names:
        answers[name], notes = match_file(file, name, clocks_apart_s, skeleton=skeleton)
        if name == names[0]:
            print_matches(str(recording_file), answers[name])
            print_notes([*file.notes, *notes])
    if len(names) > 1:
        _print_beside(answers)
    figures: dict[str, object] = {"matches": [one.to_dict() for one in answers[names[0]]], "method": names[0]}
    if len(names) > 1:
        figures["methods"] = {name: [one.to_dict() for one in found] for name, found in answers.items()}
    write_json(json_file, figures, force)


def print_matches(title: str, matches: list[ImuMatch]) -> None:
    """Print what was decided, a row an IMU."""
    rows = []
    for one in matches:
        body = "-" if one.limb is None else str(one.limb.body)
        others = ", ".join(f"{where} {p:.2f}" for where, p in one.others[:3])
        clock = None if one.limb is None else f"{one.clock_offset_s:+.2f}"
        rows.append((one.imu, body, one.joint, f"{one.probability:.3f}", clock, others or "-"))
    print_table(title, ("IMU", "body", "joint", "probability", "IMU - camera, s", "else"), rows)
    sure = sum(one.is_sure for one in matches)
    are = "is" if sure == 1 else "are"
    say(f"{sure} of {len(matches)} IMUs {are} on a limb for sure (probability above 0.95)")


def _print_beside(answers: dict[str, list[ImuMatch]]) -> None:
    """Print every method's answer, a row an IMU."""
    rows = [
        [
            found[0].imu,
            *(f"{'' if m.limb is None else m.limb.body} {m.joint} {m.probability:.2f}" for m in found),
        ]
        for found in zip(*answers.values(), strict=True)
    ]
    print_table("Every method: body, joint, probability", ("IMU", *answers), rows)
