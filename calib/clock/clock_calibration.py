"""What a solved clock network says in words, as the answer of `calibrate clock`. Every function is pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..file import CalibrationFile
from ..protocol import Answer, Verdict
from .beeps import Beep
from .links import ClockLink, ClockNetwork, Receptions
from .motion_clock import MotionClock
from .network import solve_clocks

#: A link no better than this is said to be weak, s: at 1 m/s it is 5 mm.
WEAK_S = 0.005
#: A link whose sources disagree by this many sigmas.
DISAGREE = 4.0
#: One late reception among fewer rounds than this cannot be detected.
FEW_ROUNDS = 4
SKEW_KNOWN_PPM = 20.0


@dataclass(frozen=True)
class ClockCalibration:
    """The clocks of one session, and what they were solved from."""

    session: str
    network: ClockNetwork  # Every clock against every other
    receptions: tuple[Receptions, ...] = ()  # What several clocks heard
    beeps: tuple[Beep, ...] = ()  # Of the camera's sound
    motion: MotionClock | None = None  # The clock in a recording's motion


def calibrate_clocks(
    session: str,
    receptions: Sequence[Receptions] = (),
    beeps: Sequence[Beep] = (),
    motion: MotionClock | None = None,
    origin_ns: int = 0,
) -> ClockCalibration:
    """Offsets and skews of all clocks of a session, from sound, broadcasts and motion together."""
    links = [] if motion is None else [replace(motion.link, at_s=motion.link.at_s + 1e-9 * origin_ns)]
    network = solve_clocks(receptions, links)
    return ClockCalibration(session, network, tuple(receptions), tuple(beeps), motion)


def clock_answer(calibration: ClockCalibration) -> Answer:
    """The clocks in the form that every calibration answers in."""
    network, beeps = calibration.network, calibration.beeps
    links = network.links()
    apart = disagreements(network)
    left_open = [*apart, *open_questions(calibration)]
    sentence, *findings = [text for text in verdict(network) if text not in apart]
    grade = "good" if all(link.sigma_s <= WEAK_S for link in links) else "usable"
    if apart or len(set(network.group.tolist())) > 1:
        grade = "not good enough"
    advice = next_time(calibration)
    rows = [
        {
            "from": link.from_clock,
            "to": link.to_clock,
            "offset_s": float(link.offset_s),
            "sigma_s": float(link.sigma_s),
            "skew_ppm": float(link.skew_ppm),
            "skew_sigma_ppm": float(link.skew_sigma_ppm),
            "at_s": float(link.at_s),
        }
        for link in links
    ]
    table = {"session": calibration.session, "valid_for": "this session alone", "links": rows}
    figures: dict[str, Any] = {
        "session": calibration.session,
        "links": rows,
        "sources": [
            {
                "source": left.source,
                "sigma_s": left.sigma_s,
                "used": int(left.used.sum()),
                "set_aside": int((~left.used).sum()),
                "largest_residual_s": float(abs(left.residual_s[left.used]).max(initial=0.0)),
            }
            for left in network.leftovers
        ],
        "beeps": [
            {
                "end_s": beep.end_s,
                "sigma_s": beep.sigma_s,
                "frequency_hz": beep.frequency_hz,
                "above_quiet_db": beep.above_quiet_db,
            }
            for beep in beeps
        ],
        "not_determined": left_open,
    }
    return Answer(
        Verdict(grade, sentence, tuple(findings), tuple(advice)),
        tuple(left_open),
        CalibrationFile().with_table("clock", table),
        figures,
    )


def verdict(network: ClockNetwork) -> list[str]:
    """How good the clocks are now."""
    links = network.links()
    worst = max(links, key=lambda link: link.sigma_s)
    sentences = [
        f"{len(network.nodes)} clocks are linked by {len(links)} pairs; the worst pair"
        f" ({worst.from_clock}, {worst.to_clock}) is known to {1e3 * worst.sigma_s:.2f} ms"
    ]
    if len(set(network.group.tolist())) > 1:
        groups = [
            ", ".join(name for name, own in zip(network.nodes, network.group, strict=True) if own == g)
            for g in sorted(set(network.group.tolist()))
        ]
        sentences.append(f"nothing links these groups of clocks with each other: {'; '.join(groups)}")
    sentences += disagreements(network)
    sentences.append("a clock offset is valid for its recording only: measure it again in every session")
    return sentences


def disagreements(network: ClockNetwork) -> list[str]:
    """Links that were measured in two ways which contradict each other."""
    return [
        f"{each.source} ({each.node[0]}) is {1e3 * each.residual_s[0]:+.1f} ms off the other"
        f" measurements, {abs(each.residual_s[0]) / each.sigma_s:.0f} of its sigmas: one of them is wrong"
        for each in network.leftovers
        if len(each.residual_s) == 1 and abs(each.residual_s[0]) > DISAGREE * each.sigma_s
    ]


def open_questions(calibration: ClockCalibration) -> list[str]:
    """What the data left open, one sentence each."""
    network, receptions = calibration.network, calibration.receptions
    beeps, motion = calibration.beeps, calibration.motion
    sentences = []
    for each in receptions:
        lost = sorted(set(each.node) - set(network.nodes))
        sentences += [
            f"{name} received nothing that another clock received: it is not linked" for name in lost
        ]
    parts = [
        [name for name, own in zip(network.nodes, network.group, strict=True) if own == number]
        for number in dict.fromkeys(network.group.tolist())
    ]
    if len(parts) > 1:
        apart = "; ".join(", ".join(part) for part in parts)
        sentences.append(
            f"the clocks fall into {len(parts)} groups that nothing links ({apart}): a clock that two sources"
            " share must have one name in both, see --sound-clocks and --motion-clocks"
        )
    for left in network.leftovers:
        dropped = int((~left.used).sum())
        if dropped:
            sentences.append(
                f"{left.source}: {dropped} of {len(left.used)} times did not fit and were rejected"
            )
    for link in network.links():
        pair = f"{link.from_clock} and {link.to_clock}"
        if link.sigma_s > WEAK_S:
            sentences.append(f"{pair} are known to {1e3 * link.sigma_s:.0f} ms only")
        common = _common(receptions, link)
        if 0 < common < FEW_ROUNDS and not any(beep.sigma_s < WEAK_S for beep in beeps):
            sentences.append(f"{pair} heard {common} rounds together: a late reception would go unnoticed")
    weak = [link for link in network.links() if link.skew_sigma_ppm > SKEW_KNOWN_PPM]
    if weak:
        pairs = ", ".join(f"{link.from_clock}-{link.to_clock}" for link in weak[:4])
        sentences.append(
            f"the skew of {pairs}{' and others' if len(weak) > 4 else ''} is not measured: the offset may"
            f" drift by some {6e-2 * max(link.skew_sigma_ppm for link in weak):.0f} ms per minute from the"
            " time that it is stated for"
        )
    sentences += [
        f"the beep that ends at {beep.end_s:.2f} s is followed by a loud echo: its end is known to"
        f" {1e3 * beep.sigma_s:.0f} ms only"
        for beep in beeps
        if beep.loud_room
    ]
    if motion is not None and not motion.used.all():
        sentences.append(
            f"{int((~motion.used).sum())} of {len(motion.used)} excerpts of the motion did not fit the line"
        )
    return sentences


def next_time(calibration: ClockCalibration) -> list[str]:
    """What to record next, one sentence each."""
    receptions, beeps, motion = calibration.receptions, calibration.beeps, calibration.motion
    sentences = []
    links = calibration.network.links()
    if receptions and not beeps and any(0 < _common(receptions, link) < 2 * FEW_ROUNDS for link in links):
        sentences.append("broadcast twenty rounds; every pair of nodes needs several that both received")
    if any(link.skew_sigma_ppm > SKEW_KNOWN_PPM for link in links):
        sentences.append(
            "measure once at the start and once at the end of the session: the two give the skew"
        )
    if any(beep.loud_room for beep in beeps):
        sentences.append(
            "hold the buzzer right in front of the microphone, so that it is louder than its echo"
        )
    if motion is not None and motion.link.sigma_s > 0.003:
        sentences.append("move the forearm briskly in view for 20 s; only fast motion determines the clock")
    return sentences or ["record in the same way: nothing is missing"]


def _common(receptions: Sequence[Receptions], link: ClockLink) -> int:
    """Rounds that both clocks of a link heard; 0 where a broadcast is not what links them."""
    count = 0
    for each in receptions:
        if not each.estimate_noise:
            continue
        node = np.asarray(each.node)
        first, second = each.event[node == link.from_clock], each.event[node == link.to_clock]
        count += len(np.intersect1d(first, second))
    return count
