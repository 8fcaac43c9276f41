"""Which streams of a file belong together: by option, else by name, else by motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Unpack

import numpy as np

from ...body import FURTHER
from ...errors import RecordingError
from ...runtime.store import Store
from .bodies import people
from .camera_streams import of_first_camera, same_arm
from .selection import (
    Selection,
    StreamChoice,
    choose_further,
    choose_truth,
    forearm_imus,
    named_side,
    role,
    role_among,
    wanted_arms,
    why_no_pair,
)
from .streams import ArmFrames, ImuSamples, RecordingFile

if TYPE_CHECKING:
    from ...matching import ImuMatch, Limb


#: Correlation that a pair must reach, and its lead over the next, to be taken by motion alone.
_ENOUGH, _LEAD = 0.4, 0.1
#: Where clocks are far apart the correlation of a pair must reach this.
_ENOUGH_SHIFTED = 0.6


def choose(
    file: RecordingFile,
    *,
    imu: str | None = None,
    skeleton: str | None = None,
    side: str | None = None,
    body: int | None = None,
    prefer_side: str | None = None,
    store: Store | None = None,
) -> StreamChoice:
    """Settle which IMU and arm are meant: by option, else by name, else by motion."""
    notes: list[str] = []
    file, others = of_first_camera(file, skeleton)
    if body is None:
        arms, notes = people(file, store)
        file = replace(file, arms=arms)
    arms = wanted_arms(file, skeleton, side, body)
    imus = forearm_imus(file, imu)
    pairs = [(i, a) for i in imus for a in arms if _may_match(i, a, side)]
    if not pairs:
        raise RecordingError(
            f"{file.path}: no IMU is on an arm that the skeleton shows; it has {_listing(file)};"
            f" {why_no_pair(imus, file.arms, side)}."
        )
    if prefer_side and not side:
        preferred = [(i, a) for i, a in pairs if _side(i, a) in (prefer_side, "")]
        pairs = preferred or pairs
    if len(pairs) > 1:
        pair, why = _pair_by_motion(file, pairs, store)
        notes.append(f"Of {_listing(file)}, IMU {pair[0].topic} and {pair[1].label} were taken: {why}.")
    else:
        pair = pairs[0]
        if len(file.imus) > 1 or len(file.arms) > 1:
            notes.append(f"IMU {pair[0].topic} and skeleton {pair[1].label} were taken.")
    chosen_side = _side(*pair) or side or ""
    base = next((i for i in file.imus if i is not pair[0] and role(i) == "base"), None)
    truth, truth_notes = choose_truth(file, chosen_side)
    further, further_notes = _further_by_name(file, pair[0], chosen_side)
    if role(pair[0]) == "hand":
        further_notes.append(
            f"IMU {pair[0].topic} is named after the hand and used as the forearm's: where the wrist"
            " bends, the result is off by centimetres. Wear one on the forearm too."
        )
    more = truth_notes + further_notes
    choice = StreamChoice(pair[0], pair[1], chosen_side, base, truth, notes + more, further)
    return with_cameras(choice, others, store)


def with_cameras(choice: StreamChoice, others: RecordingFile | None, store: Store | None) -> StreamChoice:
    """The same with what further cameras saw of its arm."""
    if others is None:
        return choice
    cameras, notes = same_arm(others, choice.arm, choice.imu, store)
    return replace(choice, cameras=cameras, notes=[*choice.notes, *notes])


def _may_match(imu: ImuSamples, arm: ArmFrames, side: str | None) -> bool:
    sides = {named_side(imu.topic, imu.frame_id), arm.side, side or ""} - {""}
    return len(sides) <= 1


def _side(imu: ImuSamples, arm: ArmFrames) -> str:
    return arm.side or named_side(imu.topic, imu.frame_id)


def _pair_by_motion(
    file: RecordingFile, pairs: list[tuple[ImuSamples, ArmFrames]], store: Store | None
) -> tuple[tuple[ImuSamples, ArmFrames], str]:
    from .match_streams import agreement_far_apart, motion_agreement  # SciPy: where it is used

    matches = _matches(file, pairs, store)
    matched = [(pair, match) for pair, match in matches if match.limb and match.limb.segment == "wrist"]
    if len(matched) == 1:
        pair, match = matched[0]
        return pair, f"their motion agrees best (probability {match.probability:.2f} among all limbs in view)"
    elsewhere = {
        id(imu): match
        for (imu, _), match in matches
        if match.is_sure and match.limb and match.limb.segment != "wrist"
    }
    offered = pairs
    pairs = [pair for pair, _ in matched] or [pair for pair in pairs if id(pair[0]) not in elsewhere]
    if not pairs:
        where = ", ".join(f"{m.imu} as {m.limb.label}" for m in elsewhere.values() if m.limb)
        raise RecordingError(
            f"{file.path}: no IMU moves as a forearm that the camera shows ({where}); "
            "choose with --imu and --side if one is on a forearm."
        )
    scores = np.array([motion_agreement(imu, arm) for imu, arm in pairs])
    shifted = [agreement_far_apart(imu, arm) for imu, arm in pairs]
    correlation, shift_s, far = shifted[int(np.argmax([row[0] for row in shifted]))]
    apart = ""
    if far and correlation >= max(_ENOUGH_SHIFTED, float(scores.max())):
        # the clocks are far apart: what agrees within a second does so by chance
        scores = np.array([row[0] for row in shifted])
        apart = f", with the clocks {abs(shift_s):.1f} s apart"
    order = np.argsort(-scores)
    best, second = scores[order[0]], max(scores[order[1:]].max(initial=0.0), 0.0)
    if best < _ENOUGH or best - second < _LEAD:
        options = [("--imu", len({id(i) for i, _ in offered}) > 1)]
        options += [("--skeleton", len({a.topic for _, a in offered}) > 1)]
        options += [("--side", len({a.side for _, a in offered}) > 1)]
        options += [("--body", len({(a.topic, a.body) for _, a in offered}) > 1)]
        needed = " and ".join(name for name, is_needed in options if is_needed)
        if _named_apart(offered):
            raise RecordingError(
                f"{file.path} has an IMU on each of several arms ({_listing(file)}), and one arm is wanted"
                " here; choose with --side."
            )
        raise RecordingError(
            f"{file.path} has {_listing(file)}, and their motion does not show which belong together; "
            f"choose with {needed}."
        )
    why = f"their motion agrees best{apart} (correlation {best:.2f}, the next {second:.2f})"
    further = [
        f"{match.imu} moves as {match.limb.label}"
        for pair, match in matched
        if match.limb and pair[0] is not pairs[order[0]][0]
    ]
    return pairs[order[0]], "; ".join([why, *further])


def _named_apart(pairs: list[tuple[ImuSamples, ArmFrames]]) -> bool:
    """Whether names show which IMU is on which arm, and only the arm is open."""
    sides = {named_side(imu.topic, imu.frame_id) for imu, _ in pairs}
    return "" not in sides and len(sides) == len(pairs)


def _matches(
    file: RecordingFile, pairs: list[tuple[ImuSamples, ArmFrames]], store: Store | None
) -> list[tuple[tuple[ImuSamples, ArmFrames], ImuMatch]]:
    """Pairs that one assignment of all these IMUs to all limbs of these arms makes."""
    from .match_streams import match_streams

    imus = list({id(imu): imu for imu, _ in pairs}.values())
    arms = list({id(arm): arm for _, arm in pairs}.values())
    pair_of = {(imu.topic, arm.topic, arm.body, arm.side): (imu, arm) for imu, arm in pairs}

    def may_be(row: int, limb: Limb) -> bool:
        worn_as_named = limb.segment == "wrist" or role(imus[row]) != "forearm"
        return worn_as_named and (imus[row].topic, limb.skeleton, limb.body, limb.side) in pair_of

    try:
        matches, _ = match_streams(file, imus, arms, store=store, may_be=may_be)
    except RecordingError:
        return []  # what cannot be used is said when it is read, if it is what is meant
    return [
        (pair_of[match.imu, match.limb.skeleton, match.limb.body, match.limb.side], match)
        for match in matches
        if match.limb is not None
    ]


def _listing(file: RecordingFile) -> str:
    imus = ", ".join(stream.topic for stream in file.imus)
    arms = ", ".join(arm.label for arm in file.arms if arm.tracked)
    return f"IMU {imus} and skeleton {arms}"


#: An arm is taken by motion alone where its IMU is on it with this probability.
TAKEN_FROM = 0.8
_SIDES = ("left", "right")


@dataclass(frozen=True)
class ArmChoices:
    """The arms of a file that are to be recovered."""

    chosen: tuple[StreamChoice, ...]  # One or more, in order of body and side
    left_out: tuple[str, ...] = ()  # A sentence for each arm that has an IMU and cannot be used


def choose_arms(
    file: RecordingFile,
    *,
    prefer_side: str | None = None,
    store: Store | None = None,
    **selection: Unpack[Selection],
) -> ArmChoices:
    """Settle which IMUs and arms belong together: by option, else by name, else by motion."""

    def one_arm() -> ArmChoices:
        return ArmChoices((choose(whole, prefer_side=prefer_side, store=store, **selection),))

    whole, (file, others) = file, of_first_camera(file, selection.get("skeleton"))
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
        both = _by_side(joined, selection, store, notes)
        return replace(both, chosen=tuple(with_cameras(one, others, store) for one in both.chosen))
    by_motion = _arms_by_motion(joined, arms, selection.get("side"), store, notes)
    if len(by_motion) < 2:
        return one_arm()
    return ArmChoices(tuple(with_cameras(one, others, store) for one in by_motion))


def _bodies(arms: Sequence[ArmFrames]) -> list[tuple[str, int]]:
    return sorted({(arm.topic, arm.body) for arm in arms})


def _candidates(file: RecordingFile, arms: Sequence[ArmFrames]) -> list[ImuSamples]:
    """IMUs that may be on a forearm; with several people those without a telling name as well."""
    named = forearm_imus(file, None)
    if len(_bodies(arms)) < 2:
        return named
    return [imu for imu in file.imus if role_among(imu, file.imus) in ("", "forearm")]


def _sides_settle(imus: Sequence[ImuSamples], arms: Sequence[ArmFrames]) -> bool:
    """Whether one person wears IMUs whose names show on which arm each of them is."""
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


def _arms_by_motion(
    file: RecordingFile,
    arms: Sequence[ArmFrames],
    side: str | None,
    store: Store | None,
    notes: Sequence[str],
) -> list[StreamChoice]:
    """A choice for every arm on whose forearm an IMU is, by one assignment of all IMUs to all limbs."""
    from .match_streams import match_streams

    imus = [imu for imu in file.imus if role(imu) not in ("base", "trunk")]

    def may_be(row: int, limb: Limb) -> bool:
        named, worn_on = role_among(imus[row], imus), named_side(imus[row].topic, imus[row].frame_id)
        segment = {"": limb.segment, "forearm": "wrist"}.get(named, named)
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
        on_arm = {segment: found for (*place, segment), found in on_limb.items() if tuple(place) == key}
        further, further_notes = _further(file, on_arm, imu, arm.side, several)
        base = next((i for i in file.imus if i is not imu and role(i) == "base"), None)
        body = arm.body if several else None
        truth, truth_notes = choose_truth(file, arm.side, body)
        said = [*notes, *open_notes, _taken(imu, arm, match), *truth_notes, *further_notes]
        choices.append(StreamChoice(imu, arm, arm.side, base, truth, said, further, body))
    used = {id(stream) for one in choices for stream in (one.imu, *one.further.values(), one.base)}
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


def _further_by_name(
    file: RecordingFile, forearm: ImuSamples, side: str
) -> tuple[dict[str, ImuSamples], list[str]]:
    """The IMUs that names say are on further segments of the same arm, by segment, and sentences on them."""
    further, notes = {}, []
    for segment in FURTHER:
        imu, said = choose_further(file, forearm, side, segment)
        notes += said
        if imu is not None:
            further[segment.name] = imu
    return further, notes


def _further(
    file: RecordingFile,
    on_arm: Mapping[str, tuple[ImuSamples, ImuMatch]],
    forearm: ImuSamples,
    side: str,
    several: bool,
) -> tuple[dict[str, ImuSamples], list[str]]:
    """The IMUs on the same arm's further segments: by motion, or with one person by their names."""
    further, notes = {}, []
    for segment in FURTHER:
        if segment.name in on_arm:
            imu, match = on_arm[segment.name]
            further[segment.name] = imu
            notes.append(
                f"IMU {imu.topic} is on the same arm's {segment.label} by its motion (probability"
                f" {match.probability:.2f})."
            )
        elif not several:
            named, said = choose_further(file, forearm, side, segment)
            notes += said
            if named is not None:
                further[segment.name] = named
    return further, notes
