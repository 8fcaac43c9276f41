"""Every arm of a file that has an IMU, of one person or of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Unpack

from ...errors import RecordingError
from ...runtime.store import Store
from .choose import choose, choose_upper, wanted_arms
from .imu_choice import forearm_imus
from .people import people
from .selection import Selection, StreamChoice
from .stream_names import named_side, role
from .streams import ArmFrames, ImuSamples, RecordingFile
from .truth_choice import choose_truth

if TYPE_CHECKING:
    from ...matching import ImuMatch, Limb

#: An arm is taken by motion alone where its IMU is on it with this probability.
TAKEN_FROM = 0.8
_SIDES = ("left", "right")


@dataclass(frozen=True)
class ArmChoices:
    """The arms of a file that are to be recovered.

    Attributes
    ----------
    chosen : tuple of StreamChoice
        One or more, in order of body and side.
    left_out : tuple of str
        A sentence for each arm that has an IMU and cannot be used.
    """

    chosen: tuple[StreamChoice, ...]
    left_out: tuple[str, ...] = ()


def choose_arms(
    file: RecordingFile,
    *,
    prefer_side: str | None = None,
    store: Store | None = None,
    **selection: Unpack[Selection],
) -> ArmChoices:
    """Settle which IMUs and arms belong together: by option, else by name, else by motion.

    Both arms of one person are told apart by the sides in the IMUs' names. Where names leave it open, or the
    camera saw several people, one assignment of all IMUs to all limbs settles it (`matching`). A file with
    one arm gives what `choose` gives.

    Parameters
    ----------
    file : RecordingFile
        All streams.
    prefer_side, store, imu, skeleton, side, body
        As in `choose`; `imu` or `side` restrict.

    Returns
    -------
    ArmChoices
        At least one arm.

    Raises
    ------
    RecordingError
        Nothing fits, or nothing tells what belongs together; the message lists what the file has.
    """

    def one_arm() -> ArmChoices:
        return ArmChoices((choose(file, prefer_side=prefer_side, store=store, **selection),))

    if selection.get("imu") is not None:
        return one_arm()
    wanted = (selection.get("skeleton"), selection.get("side"), selection.get("body"))
    joined = file
    notes: list[str] = []
    if wanted[2] is None:
        arms, notes = people(file, store)
        joined = replace(file, arms=arms)
    arms = wanted_arms(joined, *wanted)
    imus = _candidates(joined, arms)
    if len(imus) < 2 or len(arms) < 2:
        return one_arm()
    if _sides_settle(imus, arms):
        return _by_side(joined, selection, store, notes)
    by_motion = _by_motion(joined, arms, selection.get("side"), store, notes)
    return ArmChoices(tuple(by_motion)) if len(by_motion) > 1 else one_arm()


def _bodies(arms: Sequence[ArmFrames]) -> list[tuple[str, int]]:
    return sorted({(arm.topic, arm.body) for arm in arms})


def _candidates(file: RecordingFile, arms: Sequence[ArmFrames]) -> list[ImuSamples]:
    """IMUs that may be on a forearm; with several people those without a telling name as well."""
    named = forearm_imus(file, None)
    if len(_bodies(arms)) < 2:
        return named
    return [imu for imu in file.imus if role(imu) not in ("base", "upper_arm", "trunk")]


def _sides_settle(imus: Sequence[ImuSamples], arms: Sequence[ArmFrames]) -> bool:
    """Whether one person wears IMUs whose names say on which arm each of them is."""
    sides = {named_side(imu.topic, imu.frame_id) for imu in imus}
    return len(_bodies(arms)) == 1 and sides == set(_SIDES) and {arm.side for arm in arms} == set(_SIDES)


def _by_side(
    file: RecordingFile, selection: Selection, store: Store | None, notes: Sequence[str]
) -> ArmChoices:
    """Both arms, or the one that can be used and why the other cannot."""
    chosen, errors = [], []
    for side in _SIDES:
        options: Selection = {**selection, "side": side}
        try:
            choice = choose(file, store=store, **options)
        except RecordingError as error:
            errors.append((side, error))
            continue
        chosen.append(replace(choice, notes=[*notes, *choice.notes]))
    if not chosen:
        raise errors[0][1]
    return ArmChoices(tuple(chosen), tuple(left_out_words(f"{side} arm", error) for side, error in errors))


def left_out_words(arm: str, error: Exception) -> str:
    """That an arm is not among the results, and why."""
    return f"The {arm} was left out: {error}"


def _by_motion(
    file: RecordingFile,
    arms: Sequence[ArmFrames],
    side: str | None,
    store: Store | None,
    notes: Sequence[str],
) -> list[StreamChoice]:
    """A choice for every arm on whose forearm an IMU is, by one assignment of all IMUs to all limbs."""
    from .match_streams import match_streams  # what it imports is not needed where names settle it

    imus = [imu for imu in file.imus if role(imu) not in ("base", "trunk")]

    def may_be(row: int, limb: Limb) -> bool:
        named, worn_on = role(imus[row]), named_side(imus[row].topic, imus[row].frame_id)
        segment = {"forearm": "wrist", "upper_arm": "upper_arm"}.get(named, limb.segment)
        return limb.segment == segment and len({worn_on, limb.side, side or ""} - {""}) <= 1

    try:
        matches, open_notes = match_streams(file, imus, arms, store=store, may_be=may_be)
    except RecordingError:
        return []  # what cannot be used is said when it is read, if it is what is meant
    on_limb = {
        (match.limb.skeleton, match.limb.body, match.limb.side, match.limb.segment): (imu, match)
        for imu, match in zip(imus, matches, strict=True)
        if match.limb is not None and match.probability >= TAKEN_FROM
    }
    several = len({key[:2] for key in on_limb if key[3] == "wrist"}) > 1
    choices = []
    for arm in sorted(arms, key=lambda arm: (arm.topic, arm.body, arm.side)):
        key = (arm.topic, arm.body, arm.side)
        if (*key, "wrist") not in on_limb:
            continue
        imu, match = on_limb[*key, "wrist"]
        upper, upper_notes = _upper(file, on_limb.get((*key, "upper_arm")), imu, arm.side, several)
        base = next((i for i in file.imus if i is not imu and role(i) == "base"), None)
        body = arm.body if several else None
        truth, truth_notes = choose_truth(file, arm.side, body)
        said = [*notes, *open_notes, _taken(imu, arm, match), *truth_notes, *upper_notes]
        choices.append(StreamChoice(imu, arm, arm.side, base, truth, said, upper, body))
    used = {id(stream) for one in choices for stream in (one.imu, one.upper, one.base)}
    unused = _unused([(i, m) for i, m in zip(imus, matches, strict=True) if id(i) not in used])
    return [replace(one, notes=[*one.notes, *unused]) for one in choices]


def _unused(rest: Sequence[tuple[ImuSamples, ImuMatch]]) -> list[str]:
    """What is said of IMUs that belong to no arm that is recovered; those left open are said already."""
    notes = []
    for imu, match in rest:
        where, how_sure = match.limb, f"(probability {match.probability:.2f})"
        if where is None and match.is_known:
            notes.append(f"IMU {imu.topic} is on no limb in view {how_sure}.")
        elif where is not None and where.segment == "wrist":
            notes.append(
                f"IMU {imu.topic} may be on {where.label} {how_sure}, too doubtful to recover that arm;"
                f" if it is, give --imu {imu.topic}."
            )
        elif where is not None:
            notes.append(
                f"IMU {imu.topic} is on {where.label} {how_sure} and not used: that forearm has none."
            )
    return notes


def _taken(imu: ImuSamples, arm: ArmFrames, match: ImuMatch) -> str:
    return (
        f"IMU {imu.topic} and {arm.label} were taken: their motion agrees best (probability"
        f" {match.probability:.2f} among all limbs in view)."
    )


def _upper(
    file: RecordingFile,
    matched: tuple[ImuSamples, ImuMatch] | None,
    forearm: ImuSamples,
    side: str,
    several: bool,
) -> tuple[ImuSamples | None, list[str]]:
    """The IMU on the same upper arm: by motion, or with one person by its name."""
    if matched is not None:
        imu, match = matched
        return imu, [
            f"IMU {imu.topic} is on the same arm's upper arm by its motion (probability"
            f" {match.probability:.2f})."
        ]
    return (None, []) if several else choose_upper(file, forearm, side)
