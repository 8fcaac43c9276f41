"""A methods section: sentences, a table, what its authors have to fill in, and the references it cites."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from ..baselines.registry import BASELINES
from ..error_radius import in_cm, within_words
from ..result.verdict import SelfCheck
from .facts import ArmFacts
from .references import ORIENTATION_WORDS, REFERENCES, Reference

#: Who cites what: "[@forster2017]".
CITATION = re.compile(r"\[@([a-z]+\d*)\]")
#: Items of the ISB's recommendations, and of every study, that a result does not know.
TO_FILL_IN = (
    "Participants: number, age, sex, diagnosis, the arm that was studied; ethics approval and consent.",
    "Tasks: instructions, movements, repetitions, seated or standing, pauses, number of trials.",
    "IMU: maker, model and firmware; ranges of accelerometer and gyroscope; filters inside the sensor;"
    " logged on board or sent by radio.",
    "IMU placement: landmarks, distance from the wrist, how it was attached and by whom; whether it was"
    " taken off between trials.",
    "Calibration of the IMU itself before the session (rest, rotations, magnetometer), if there was one.",
    "Depth camera: maker, model, body-tracking software with its version and settings; distance, height and"
    " angle to the participant, light.",
    "How the devices were recorded: by one computer or apart, and what their stamps mean.",
    "What was computed afterwards: filters, angles, outcome measures, statistics.",
    "Validation against an independent reference in your laboratory, if there was one.",
    "Availability of data and code.",
)
#: Those that a simulation leaves open too: it has neither participants nor devices.
OF_ANY = tuple(item for item in TO_FILL_IN if item.startswith(("What was computed", "Availability")))


@dataclass(frozen=True)
class MethodsSection:
    """What is said of one arm.

    Attributes
    ----------
    heading : str
    sentences : tuple of str
        The paragraph; "[@key]" cites.
    rows : tuple of (str, str)
        The table.
    notes : tuple of str
        The program's notes on the recording.
    """

    heading: str
    sentences: tuple[str, ...]
    rows: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Document:
    """A methods section in no markup.

    Attributes
    ----------
    arms : tuple of MethodsSection
    to_fill_in : tuple of str
        What the result does not know.
    references : tuple of Reference
        In the order in which they are cited.
    """

    arms: tuple[MethodsSection, ...]
    to_fill_in: tuple[str, ...]
    references: tuple[Reference, ...]


def methods_document(arms: Sequence[ArmFacts]) -> Document:
    """The methods section of a result.

    Parameters
    ----------
    arms : sequence of ArmFacts
        Of one result, at least one.

    Returns
    -------
    document : Document
        Its sentences state facts of the result; what it does not know is left to the authors.
    """
    sections = tuple(
        MethodsSection(
            f"{facts.recording}, {facts.arm}", tuple(_sentences(facts)), tuple(_rows(facts)), facts.notes
        )
        for facts in arms
    )
    cited = dict.fromkeys(
        key for section in sections for text in section.sentences for key in CITATION.findall(text)
    )
    cited["cereatti2024"] = None  # of the list of what to fill in
    version = arms[0].version or "not stated"
    references = tuple(
        replace(REFERENCES[key], text=REFERENCES[key].text.format(version=version)) for key in cited
    )
    return Document(sections, tuple(_to_fill_in(arms)), references)


def _to_fill_in(arms: Sequence[ArmFacts]) -> Iterator[str]:
    yield from OF_ANY if all(facts.simulation for facts in arms) else TO_FILL_IN
    if untrusted := sum(facts.untrusted_gaps for facts in arms):
        yield (
            f"What was done with the {_count(untrusted, 'gap')} that the program does not trust (left out, or"
            " kept, and why)."
        )


def _sentences(facts: ArmFacts) -> Iterator[str]:
    for group in (_sensors, _method, _calibration, _clocks, _occlusions, _uncertainty, _verdict):
        yield from group(facts)


def _sensors(facts: ArmFacts) -> Iterator[str]:
    if facts.simulation:
        yield (
            f"The recording is a simulation ('{facts.simulation}'): camera, IMU and arm below are"
            " simulated ones."
        )
    names = [joint.name for joint in facts.joints]
    strap_alone = names == ["strap"]
    tracking = "that tracked the strap of the IMU" if strap_alone else "with skeleton tracking"
    imus = ["forearm", *(imu.segment for imu in facts.further_imus)]
    units = "an inertial measurement unit (IMU)" if len(imus) == 1 else "inertial measurement units (IMUs)"
    whose = "forearm: " if len(imus) > 1 else ""
    yield (
        f"The {facts.arm} was recorded for {facts.length_s:.1f} s by a camera {tracking}"
        f" ({facts.camera_frames} frames, median rate {facts.camera_rate_hz:.1f} Hz) and by {units} on the"
        f" {_listed(imus)} ({whose}{facts.imu_samples} samples, median rate {facts.imu_rate_hz:.1f} Hz)."
    )
    if names and not strap_alone:
        shares = _listed([f"the {joint.name} in {_percent(joint.tracked)}" for joint in facts.joints])
        yield f"The camera tracked {shares} of its frames."


def _method(facts: ArmFacts) -> Iterator[str]:
    program = f"unocclude{f' {facts.version}' if facts.version else ''} [@unocclude]"
    sized = ""
    if facts.window_s and facts.margin_s:
        sized = f" of about {facts.window_s:g} s, with {facts.margin_s:g} s of visible time beside each gap,"
    graph = f"by factor graphs in overlapping windows{sized} solved with GTSAM [@gtsam]"
    if facts.method == "graph":
        yield (
            f"Its motion was estimated offline with {program}, jointly from both sensors as a maximum a"
            f" posteriori solution {graph}."
        )
        yield (
            "The IMU's samples entered by preintegration on the manifold [@forster2017], the camera's joints"
            " with Cauchy's loss; start values of the orientation came from the filter VQF [@laidig2023]."
        )
    else:
        entry = BASELINES.get(facts.method)
        yield (
            f"Its motion was computed offline with {program} by the method '{facts.method}'"
            f"{f': {entry.words}' if entry else ''}."
        )
        if facts.orientation:
            whose = ORIENTATION_WORDS.get(facts.orientation, facts.orientation)
            yield f"Its orientation filter was {whose}."
        yield (
            "Calibration, clock offset, direction of gravity, occlusions and accepted camera samples were"
            f" those of the program's own estimate {graph}."
        )
    if any(imu.segment == "trunk" for imu in facts.further_imus):
        yield (
            "The thorax's orientation was found beside the arm, from the trunk's IMU by VQF [@laidig2023] and"
            " the camera's line of both shoulders."
        )
    if facts.magnetometer_used:
        yield (
            f"The magnetometer's direction was used in {facts.magnetometer_used} of"
            f" {facts.magnetometer_means} means over some seconds."
        )
    elif facts.method == "graph":
        yield "No magnetometer was used in the estimate."
    if facts.angles:
        yield (
            f"Joint angles that the result determines ({_listed([_plain(name) for name in facts.angles])})"
            " follow the ISB's definitions [@wu2005]"
            f"{_facing(facts)}."
        )


def _facing(facts: ArmFacts) -> str:
    """Of the shoulder's angles that need no trunk."""
    is_shoulder = any(name.startswith("shoulder") for name in facts.angles)
    return ", with the trunk taken as upright and facing the camera" if is_shoulder else ""


def _calibration(facts: ArmFacts) -> Iterator[str]:
    levers = [joint for joint in facts.joints if joint.lever_m is not None]
    given = [joint.name for joint in levers if joint.given]
    found = [joint.name for joint in levers if not joint.given]
    parts = [f"the place of {_listed(given)} in the IMU's axes"] if given else []
    parts += ["the upper arm's length"] if facts.upper_arm_given else []
    parts += ["the forearm's axes in the IMU"] if facts.forearm_axes == "given" else []
    if parts:
        verb = "was" if len(parts) == 1 and facts.forearm_axes != "given" else "were"
        priors = "; places and lengths entered with standard deviations and were adjusted by the estimate"
        is_adjusted = bool(given) or facts.upper_arm_given
        yield f"Given beforehand {verb} {_listed(parts)}{priors if is_adjusted else ''}."
    parts = [f"the place of {_listed(found)} in the IMU's axes"] if found else []
    parts += ["the upper arm's length"] if facts.upper_arm_m is not None and not facts.upper_arm_given else []
    parts += ["the forearm's axes in the IMU"] if facts.forearm_axes == "estimated" else []
    parts += ["the biases of gyroscope and accelerometer"] if facts.gyroscope_bias is not None else []
    if parts:
        yield f"Estimated from the motion in the recording were {_listed(parts)}."


def _clocks(facts: ArmFacts) -> Iterator[str]:
    if not math.isfinite(facts.clock_offset_s):
        return
    spread = f" (standard deviation {1e3 * facts.clock_sigma_s:.1f} ms)" if facts.clock_sigma_s > 0.0 else ""
    start = ""
    if facts.clock_given_s is not None:
        offset_s, sigma_s = facts.clock_given_s
        start = f", starting from a measured {1e3 * offset_s:+.1f} ms with {1e3 * sigma_s:.1f} ms,"
    yield (
        f"The offset between the clocks of IMU and camera{start} was estimated from the motion as"
        f" {1e3 * facts.clock_offset_s:+.1f} ms{spread}."
    )
    pairing = facts.pairing
    if pairing is not None and pairing.proved and math.isfinite(pairing.chance) and pairing.chance > 0.0:
        yield (
            "That both streams are of one motion was tested: unrelated streams agree as well with a"
            f" probability of at most {_small(pairing.chance)}."
        )
    if pairing is not None and not pairing.proved:
        yield "That both streams are of one motion was tested and not proved."


def _occlusions(facts: ArmFacts) -> Iterator[str]:
    if not facts.gaps:
        yield "The forearm was never occluded."
    else:
        times = "once" if facts.gaps == 1 else f"{facts.gaps} times"
        yield (
            f"The forearm was occluded {times}, for {facts.occluded_s:.1f} s in total"
            f" ({_percent(facts.occluded_share)} of the recording), at most for {facts.longest_gap_s:.1f} s."
        )
        if facts.one_sided_gaps:
            yield (
                f"Of these gaps {facts.one_sided_gaps} {_was(facts.one_sided_gaps)} bounded by visible"
                " motion on one side only, or on none."
            )
    if facts.rejected_samples:
        yield (
            f"Of {facts.tracked_samples} joint samples that the camera called tracked,"
            f" {facts.rejected_samples} {_was(facts.rejected_samples)} rejected."
        )
    if facts.answered < 1.0:
        yield f"The method has an answer at {_percent(facts.answered)} of the IMU's samples."


def _uncertainty(facts: ArmFacts) -> Iterator[str]:
    if facts.gaps and facts.gap_error_95_m is not None:
        turned = (
            f", and its orientation with a standard deviation of {facts.gap_sigma_deg:.1f} degrees"
            if facts.gap_sigma_deg is not None
            else ""
        )
        yield (
            "By its stated covariance the IMU's position at the least certain moment of all gaps is known"
            f" {within_words(facts.gap_error_95_m)}{turned}."
        )
    if facts.sigma_factors:
        low, high = min(facts.sigma_factors), max(facts.sigma_factors)
        by = f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} to {high:.2f}"
        yield f"Standard deviations of positions in gaps were multiplied by {by}, as hidden gaps required."
    check = facts.self_check
    if check is not None and check.stretches:
        times = "once" if check.stretches == 1 else f"{check.stretches} times"
        yield (
            f"As a check inside the recording, the camera's forearm was hidden {times} for"
            f" {check.length_s:.1f} s (median) where it was visible, and recovered{_checked(check)}."
        )
        yield "That compares with the camera's own joints, not with an independent reference."
    if facts.draws:
        yield (
            f"The result contains {facts.draws} motions drawn from the posterior distribution, for intervals"
            " of what is computed from it."
        )


def _checked(check: SelfCheck) -> str:
    if check.unanswered == check.stretches:
        return ": that was not possible"
    if math.isfinite(check.error_95_m):
        found = f" {within_words(check.error_95_m)} (stated: {in_cm(check.stated_95_m)}"
    else:
        found = f" to {in_cm(check.rms_m)} rms (stated: {in_cm(check.stated_sigma_m)}"
    inside = (
        f"; {_percent(check.inside_95)} of the samples inside the stated 95 % region"
        if math.isfinite(check.inside_95)
        else ""
    )
    lost = f", {check.unanswered} of them not at all" if check.unanswered else ""
    return f"{found}{inside}){lost}"


def _verdict(facts: ArmFacts) -> Iterator[str]:
    if facts.verdict:
        whose = "" if facts.method == "graph" else " on its own estimate"
        yield f'The program\'s verdict{whose}: "{facts.verdict.rstrip(".")}".'
    if facts.untrusted_gaps:
        yield f"It marks {facts.untrusted_gaps} of {_count(facts.gaps, 'gap')} as not to be trusted."
    if facts.settings:
        yield (
            "Settings other than the program's defaults were"
            f" {_listed([f'{each.name} = {each.value}' for each in facts.settings])}."
        )


def _rows(facts: ArmFacts) -> Iterator[tuple[str, str]]:
    yield "Program, method", f"unocclude {facts.version or '(version not stated)'}, {facts.method}"
    own = f" ({facts.simulation})" if facts.simulation else ""
    yield "Recording", f"{facts.recording}{own}, {facts.arm}, {facts.length_s:.1f} s"
    yield "Camera", f"{facts.camera_frames} frames, {facts.camera_rate_hz:.1f} Hz (median)"
    yield "IMU on the forearm", f"{facts.imu_samples} samples, {facts.imu_rate_hz:.1f} Hz (median)"
    for imu in facts.further_imus:
        words = [f"answer at {_percent(imu.answered)} of the samples"]
        if math.isfinite(imu.clock_offset_s):
            words.append(f"clock {1e3 * imu.clock_offset_s:+.1f} ms against the camera")
        if math.isfinite(imu.mount_sigma_deg):
            words.append(f"bone axes to {imu.mount_sigma_deg:.1f} degrees")
        yield f"IMU on the {imu.segment}", ", ".join(words)
    for joint in facts.joints:
        noise = f", noise {1e3 * joint.sample_sigma_m:.1f} mm per axis" if joint.sample_sigma_m else ""
        yield f"Camera: {joint.name}", f"tracked in {_percent(joint.tracked)} of the frames{noise}"
    for joint in facts.joints:
        if joint.lever_m is not None and joint.lever_sigma_m is not None:
            place = ", ".join(
                f"{1e3 * value:.1f} ± {1e3 * sigma:.1f}"
                for value, sigma in zip(joint.lever_m, joint.lever_sigma_m, strict=True)
            )
            yield f"Place of the {joint.name} in the IMU's axes, mm", f"{place} ({_origin(joint.given)})"
    if facts.upper_arm_m is not None and facts.upper_arm_sigma_m is not None:
        length = f"{1e3 * facts.upper_arm_m:.1f} ± {1e3 * facts.upper_arm_sigma_m:.1f}"
        yield "Upper arm's length, mm", f"{length} ({_origin(facts.upper_arm_given)})"
    yield "Forearm's axes in the IMU", facts.forearm_axes or "not determined"
    if facts.gyroscope_bias is not None:
        yield "Gyroscope's bias, degrees/s", _vector(facts.gyroscope_bias, math.degrees(1.0))
    if facts.accelerometer_bias is not None:
        yield "Accelerometer's bias, m/s^2", _vector(facts.accelerometer_bias, 1.0)
    if math.isfinite(facts.clock_offset_s):
        spread = f" ± {1e3 * facts.clock_sigma_s:.1f}" if facts.clock_sigma_s > 0.0 else ""
        yield "Clock of IMU minus camera, ms", f"{1e3 * facts.clock_offset_s:+.1f}{spread}"
    yield "Gaps", f"{facts.gaps}, {facts.occluded_s:.1f} s in total, longest {facts.longest_gap_s:.1f} s"
    if facts.gaps and facts.gap_error_95_m is not None:
        yield "95 of 100 position errors in gaps, at worst", in_cm(facts.gap_error_95_m)
    if facts.max_sigma_m is not None:
        yield "Marked as not to be used", f"samples with sigma above {facts.max_sigma_m:g} m"
    if facts.self_check is not None:
        yield "Self-check", facts.self_check.sentence.removeprefix("Self-check: ").rstrip(".")
    for setting in facts.settings:
        may = ", set or adapted to the recording" if setting.adapted else ""
        yield f"Setting {setting.name}", f"{setting.value} (default {setting.default}{may})"


def _was(count: int) -> str:
    return "was" if count == 1 else "were"


def _origin(given: bool) -> str:
    return "given beforehand, adjusted" if given else "estimated"


def _vector(values: Sequence[float], factor: float) -> str:
    return ", ".join(f"{factor * value:+.3f}" for value in values)


def _percent(share: float) -> str:
    """A share; never rounded to all or nothing where it is neither."""
    text = f"{100.0 * share:.0f}"
    if (text == "100" and share < 1.0) or (text == "0" and share > 0.0):
        text = f"{100.0 * share:.2f}"
        text = "less than 100" if text == "100.00" else "less than 0.01" if text == "0.00" else text
    return f"{text} %"


def _small(chance: float) -> str:
    """A probability, rounded up: "0.00001"."""
    if chance >= 0.01:
        return f"{math.ceil(100.0 * chance) / 100.0:.2f}"
    digits = -math.floor(math.log10(chance))
    return f"{math.ceil(chance * 10.0**digits) / 10.0**digits:.{digits}f}"


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _plain(name: str) -> str:
    return name.replace("_", " ")
