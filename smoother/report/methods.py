"""The methods section of a paper about a result: sentences, a table, what its authors add, references."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..baselines.registry import BASELINES
from ..error_radius import in_cm, within_words
from ..evaluation.summary import gap_summaries
from ..linalg import median_rate_hz
from ..recording import JOINTS
from ..result import Recovery

#: What sentences cite as "[@key]"; a DOI only where it is known for certain.
REFERENCES = {
    "unocclude": "the unocclude contributors. unocclude (software), version {version}.",
    "gtsam": "F. Dellaert and GTSAM contributors. GTSAM. https://github.com/borglab/gtsam",
    "forster2017": "C. Forster, L. Carlone, F. Dellaert, D. Scaramuzza. On-manifold preintegration for"
    " real-time visual-inertial odometry. IEEE Trans. Robotics 33(1), 2017. doi:10.1109/TRO.2016.2597321",
    "laidig2023": "D. Laidig, T. Seel. VQF: highly accurate IMU orientation estimation with bias estimation"
    " and magnetic disturbance rejection. Information Fusion 91, 2023. doi:10.1016/j.inffus.2022.10.014",
    "wu2005": "G. Wu et al. ISB recommendation on definitions of joint coordinate systems, part II. Journal"
    " of Biomechanics 38(5), 2005. doi:10.1016/j.jbiomech.2004.05.042",
    "cereatti2024": "A. Cereatti et al. ISB recommendations on the definition, estimation, and reporting of"
    " joint kinematics using wearable inertial measurement technology. Journal of Biomechanics 173, 2024."
    " doi:10.1016/j.jbiomech.2024.112225",
    "jatesiktat2017": "P. Jatesiktat, W. T. Ang. Recovery of forearm occluded trajectory in Kinect using a"
    " wrist-mounted inertial measurement unit. EMBC, 2017.",
    "bell1994": "B. M. Bell. The iterated Kalman smoother as a Gauss-Newton method. SIAM J. Optimization,"
    " 1994.",
    "tian2015": "Tian et al. Neurocomputing, 2015 (unscented Kalman filter).",
    "feng2014": "Feng. Thesis, University of Glasgow, 2014.",
    "le2017": "Le. Thesis, Texas A&M University, 2017.",
    "fritsch1980": "F. N. Fritsch, R. E. Carlson. Monotone piecewise cubic interpolation. SIAM J. Numerical"
    " Analysis 17, 1980.",
    "madgwick2010": "S. O. H. Madgwick. Report (orientation filter), 2010.",
    "comotti2013": "Comotti. 2013 (orientation filter).",
}  # fmt: skip
ORIENTATION_WORDS = {
    "vqf": "VQF [@laidig2023]",
    "madgwick": "Madgwick's [@madgwick2010]",
    "comotti": "Comotti's [@comotti2013]",
    "complementary": "a complementary filter [@feng2014]",
}
CITATION = re.compile(r"\[@([a-z]+\d*)\]")
#: Items of the ISB's recommendations [@cereatti2024] that a result does not know.
TO_FILL_IN = (
    "Participants: number, age, sex, diagnosis, the arm that was studied; ethics approval and consent.",
    "Tasks: instructions, movements, repetitions, pauses, number of trials.",
    "IMU: maker, model, firmware, ranges, filters inside the sensor; landmarks of its placement, attachment.",
    "Depth camera: maker, model, body-tracking software; distance, height and angle to the participant.",
    "How the devices were recorded, and calibrations before the session.",
    "What was computed afterwards: filters, angles, outcome measures, statistics; an independent validation.",
    "Availability of data and code.",
)


def methods_section(
    recoveries: Sequence[Recovery], version: str, simulation: str
) -> tuple[str, dict[str, object]]:
    """The Markdown of a result's arms, and its parts for JSON; `simulation`: the title of a simulated one."""
    arms: list[dict[str, Any]] = [
        {
            "heading": f"{one.name}, {one.arm_label}",
            "sentences": list(_sentences(one, version, simulation)),
            "rows": [list(row) for row in _rows(one, version)],
            "notes": list(one.notes),
        }
        for one in recoveries
    ]
    cited = dict.fromkeys(key for arm in arms for text in arm["sentences"] for key in CITATION.findall(text))
    cited["cereatti2024"] = None
    references = {key: REFERENCES[key].format(version=version or "not stated") for key in cited}
    numbers = {key: str(n) for n, key in enumerate(references, start=1)}
    to_fill_in = list(TO_FILL_IN[-2:] if simulation else TO_FILL_IN)
    if untrusted := sum(len(_untrusted(one)) for one in recoveries):
        to_fill_in.append(f"What was done with the {untrusted} gaps that the program does not trust.")
    lines = []
    for arm in arms:
        lines += [f"## Methods: {_cell(str(arm['heading']))}", "", " ".join(arm["sentences"]), ""]
        lines += ["| | |", "|---|---|", *(f"| {_cell(a)} | {_cell(b)} |" for a, b in arm["rows"]), ""]
        lines += [*(f"- {_cell(note)}" for note in arm["notes"]), ""]
    lines += ["### For you to fill in [@cereatti2024]", "", *(f"- {item}" for item in to_fill_in), ""]
    lines += ["### References", "", *(f"{numbers[key]}. {text}" for key, text in references.items())]
    text = CITATION.sub(lambda found: f"[{numbers[found[1]]}]", "\n".join(lines)) + "\n"
    return text, {"arms": arms, "to_fill_in": to_fill_in, "references": references, "text": text}


def _sentences(one: Recovery, version: str, simulation: str) -> Iterator[str]:
    """What was recorded, how it was solved, what was given and found, and how certain it is."""
    found, is_graph, frames = one.estimates, one.method == "graph", np.asarray(one.arm.t_s)
    length_s = float(one.t_s[-1] - one.t_s[0]) if len(one) else 0.0
    if simulation:
        yield f"The recording is a simulation ('{simulation}')."
    imus = ["forearm", *one.segments, *(["trunk"] if one.trunk else [])]
    yield (
        f"The {one.arm_label} was recorded for {length_s:.1f} s by a camera ({len(frames)} frames, median"
        f" rate {median_rate_hz(frames):.1f} Hz) and by an IMU on the {_listed(imus).replace('_', ' ')}"
        f" ({len(one)} samples of the forearm's, median rate {median_rate_hz(one.t_s):.1f} Hz)."
    )
    program = f"unocclude {version} [@unocclude]".replace("  ", " ")
    if is_graph:
        yield (
            f"Its motion was estimated offline with {program}, jointly from both sensors as a maximum a"
            " posteriori solution of a factor graph with GTSAM [@gtsam]; the IMU entered by preintegration on"
            " the manifold [@forster2017], start values of the orientation came from VQF [@laidig2023]."
        )
    else:
        entry, filter_ = BASELINES.get(one.method), str(found.further.get("orientation", ""))
        yield f"Its motion was computed offline with {program} by {entry.words if entry else one.method}."
        if filter_:
            yield f"Its orientation filter was {ORIENTATION_WORDS.get(filter_, filter_)}."
        yield ("Calibration, clock offset, gravity and accepted camera samples were those of the graph.")
    if used := found.magnetometer_blocks_used:
        yield f"The magnetometer was used in {used} of {found.magnetometer_blocks} means."
    if set(found.given):
        yield f"Given beforehand: {_listed(sorted(found.given)).replace('_', ' ')}; all else was estimated."
    if math.isfinite(one.clock_offset_s):
        given = ""
        if found.clock_given_s is not None:
            offset_ms, sigma_ms = (1e3 * value for value in found.clock_given_s)
            given = f" (measured beforehand: {offset_ms:+.1f} ms with {sigma_ms:.1f} ms)"
        yield f"The clock offset of IMU and camera was estimated as {_ms(one)}{given}."
    if found.pairing is not None:
        proof = f"proved (by chance: {found.pairing.chance:.1g})" if found.pairing.proved else "not proved"
        yield f"That both streams are of one motion was tested and {proof}."
    gaps = gap_summaries(one)
    if gaps:
        lengths_s = [gap.length_s for gap in one.gaps]
        yield (
            f"The forearm was occluded in {len(gaps)} gaps of {sum(lengths_s):.1f} s in total"
            f" ({100 * sum(lengths_s) / length_s:.0f} % of the recording), the longest of"
            f" {max(lengths_s):.1f} s; {sum(gap.one_sided for gap in gaps)} were not bounded by"
            " visible motion on both sides."
        )
        if worst := [gap.error_95_m for gap in gaps if gap.error_95_m is not None]:
            yield f"By its covariance the IMU's position is known in all of them {within_words(max(worst))}."
    else:
        yield "The forearm was never occluded."
    if factors := [factor for factor in found.sigma_factors if factor != 1.0]:
        yield f"Standard deviations in gaps were multiplied by {min(factors):.2f} to {max(factors):.2f}."
    if is_graph and found.self_check is not None:
        said = found.self_check.sentence.rstrip(".")
        yield f"{said} (against the camera's own joints, no independent reference)."
    if one.draws is not None:
        yield f"Intervals come from {len(one.draws)} motions drawn from the posterior distribution."
    if found.verdict:
        whose, verdict = "" if is_graph else " on its graph", found.verdict.rstrip(".")
        yield f'The program\'s verdict{whose}: "{verdict}"; {len(_untrusted(one))} gaps not trusted.'


def _rows(one: Recovery, version: str) -> Iterator[tuple[str, str]]:
    """The table: noise, places and lengths with sigma, biases, clock."""
    found, arm = one.estimates, one.calibration
    yield "Program, method", f"unocclude {version or '(version not stated)'}, {one.method}"
    for joint in JOINTS:
        if joint in (found.camera_sigma_m or {}):
            yield f"Camera noise: {joint}, mm per axis", f"{1e3 * (found.camera_sigma_m or {})[joint]:.1f}"
    for joint, lever in () if arm is None else arm.lever_arms.items():
        place = ", ".join(
            f"{1e3 * value:.1f} ± {1e3 * sigma:.1f}"
            for value, sigma in zip(lever.position_m, np.broadcast_to(lever.sigma_m, 3), strict=True)
        )
        yield f"Place of the {joint} in the IMU's axes, mm", f"{place} ({_origin(joint in found.given)})"
    if arm is not None and arm.upper_arm is not None:
        length = f"{1e3 * arm.upper_arm.value_m:.1f} ± {1e3 * arm.upper_arm.sigma_m:.1f}"
        yield "Upper arm's length, mm", f"{length} ({_origin('upper_arm' in found.given)})"
    if found.gyroscope_bias is not None:
        yield (
            "Gyroscope's bias, degrees/s",
            ", ".join(f"{math.degrees(v):+.3f}" for v in found.gyroscope_bias),
        )
    if found.accelerometer_bias is not None:
        yield "Accelerometer's bias, m/s^2", ", ".join(f"{v:+.3f}" for v in found.accelerometer_bias)
    if math.isfinite(one.clock_offset_s):
        yield "Clock of IMU minus camera", _ms(one)
    if worst := [gap.error_95_m for gap in gap_summaries(one) if gap.error_95_m is not None]:
        yield "95 of 100 position errors in gaps, at worst", in_cm(max(worst))
    for section, settings in one.config.items():
        for key, value, usual in _changed(section, settings):
            yield f"Setting {section}.{key}", f"{value} (default {usual}; set, or adapted to the recording)"


def _changed(section: str, settings: object) -> Iterator[tuple[str, object, object]]:
    """A section's settings that are not the defaults."""
    from ..config import Config

    usual = Config().model_dump(mode="json", exclude_none=True).get(section, {})
    if isinstance(settings, dict):
        yield from ((k, v, usual[k]) for k, v in settings.items() if k in usual and v != usual[k])


def _untrusted(one: Recovery) -> list[int]:
    return [n for n, gap in enumerate(gap_summaries(one)) if gap.trusted is False]


def _origin(given: bool) -> str:
    return "given beforehand, adjusted" if given else "estimated"


def _ms(one: Recovery) -> str:
    return f"{1e3 * one.clock_offset_s:+.1f} ± {1e3 * one.clock_offset_sigma_s:.1f} ms"


def _cell(text: str) -> str:
    """Text in which Markdown finds no markup."""
    return re.sub(r"([\\|*_`<\[])", r"\\\1", text)


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
