"""Faults fed into the live smoother: `python -m tools.live_faults [--seeds 1 2] [--only TEXT ..] [--say]`.

Prints for each kind the time with an error beyond three stated sigmas, that without an answer, the largest
error in sigmas with the sigma that was stated, the error of the last five seconds, after how long something
was said or doubted, and the first sentence; ends with 1 where it was wrong for longer than 0.5 s. All kinds
of a seed branch off one sound session, and end some seconds after the fault.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from smoother.body import FOREARM
from smoother.live.answers import LiveOutput, LiveState
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.recording import JOINTS, ImuStream
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.streams.arrivals import Arrivals, FrameRows, ImuRows, LiveStep, SourceInfo
from smoother.streams.replay import Playback
from smoother.streams.session import LiveSession
from smoother.units import GRAVITY

#: A kind holds where the answer is wrong for no longer, s: its error exceeds this many of its sigmas.
MOST_S, SIGMAS = 0.5, 3.0
#: When faults begin, s, and how long a session goes on after one: most end before the second calibration, s.
AT_S, AFTER_S = 17.0, 5.9
#: A session of half a minute on a busy machine takes no longer, s.
LONGEST_S = 400.0
LATENCY_S, OFFSET_S, STEP_S = 0.1, -0.02, 1 / 30
#: Samples that a sensor sends together.
TOGETHER = 3

Rows = ImuRows | FrameRows
#: Rows by stream: IMUs by segment, the forearm's first, and "frames".
Streams = dict[str, Rows]
#: Of rows, which are at fault, when each arrives after the fault began (s), and random numbers: other rows.
Damage = Callable[[Any, np.ndarray, np.ndarray, np.random.Generator], Rows]


class Fault(NamedTuple):
    """What happens to a stream."""

    stream: str  # "imu" or "frames"
    length_s: float  # inf: from then on
    damage: Damage


# Single values: `change` gets random numbers and acc and gyro (n, 3), or positions (n, 5, 3), to change.


def _values(change: Callable[..., object]) -> Damage:
    def damage(rows: Any, on: np.ndarray, s: np.ndarray, rng: np.random.Generator) -> Rows:
        names = ("acc", "gyro") if isinstance(rows, ImuRows) else ("position",)
        columns = {name: getattr(rows, name).copy() for name in names}
        parts = [columns[name][on] for name in names]
        change(rng, *parts)
        for name, part in zip(names, parts, strict=True):
            columns[name][on] = part
        return replace(rows, **columns)

    return damage


def _hold(*arrays: np.ndarray) -> None:
    for values in arrays:
        values[:] = values[0]


def _scale(factor: float, *arrays: np.ndarray) -> None:
    for values in arrays:
        values *= factor


def _spikes(values: np.ndarray, size: float, rng: np.random.Generator) -> None:
    hit = rng.random(len(values)) < 0.01
    axes = rng.normal(size=(int(hit.sum()), 3))
    values[hit] += size * axes / np.linalg.norm(axes, axis=1)[:, None]


def _noisy_hold(rng: np.random.Generator, position: np.ndarray) -> None:
    position[:] = position[0] + rng.normal(scale=0.003, size=position.shape)


def _shorter(rng: np.random.Generator, position: np.ndarray) -> None:
    """A child 0.6 m beside: every bone a quarter shorter."""
    middle = position[:, [JOINTS.index("shoulder")]]
    position[:] = middle + 0.75 * (position - middle) + np.array([0.6, 0.0, 0.0])


def _at_the_hip(rng: np.random.Generator, position: np.ndarray) -> None:
    """Elbow and wrist guessed: beside the trunk, a little noise."""
    shoulder, noise = JOINTS.index("shoulder"), rng.normal(scale=0.005, size=(len(position), 2, 3))
    for place, (joint, down_m) in enumerate((("elbow", 0.28), ("wrist", 0.52))):
        column = JOINTS.index(joint)
        off, sunk = position[:, column] - position[:, shoulder], np.zeros(3)
        sunk[int(np.argmax(np.abs(np.nanmean(off[:, :2], axis=0))))] = 0.05
        sunk[1] += down_m
        position[:, column] = position[:, shoulder] + sunk + noise[:, place]


def _other_arm(rng: np.random.Generator, position: np.ndarray) -> None:
    """Left and right exchanged: the arm 0.36 m beside, which hangs still."""
    first = position[0].copy()
    position[:] = first + np.array([0.36, 0.0, 0.0]) + 0.1 * (position - first)


def _jumps(rng: np.random.Generator, position: np.ndarray) -> None:
    """One frame in twenty is half a metre off."""
    hit = rng.random(len(position)) < 0.05
    position[hit] += rng.choice([-0.5, 0.5], (int(hit.sum()), 1, 3))


# Rows that do not come, come again, late, or with other stamps.


def _kept(wanted: Callable[[np.ndarray, np.random.Generator], Any]) -> Damage:
    """Of the rows at fault only some; each as often as is said."""

    def damage(rows: Any, on: np.ndarray, s: np.ndarray, rng: np.random.Generator) -> Rows:
        number = np.arange(len(on))
        return rows.select(np.repeat(number, np.where(on, wanted(number, rng), 1)))  # type: ignore[no-any-return]

    return damage


def _arriving(later_s: Callable[[np.ndarray, np.random.Generator], Any]) -> Damage:
    """The stamps stay right, the arrivals are later."""
    return lambda rows, on, s, rng: replace(rows, arrival_s=rows.arrival_s + np.where(on, later_s(s, rng), 0))


def _stamped(off_s: Callable[[np.ndarray, np.random.Generator], Any]) -> Damage:
    """The arrivals stay right, the stamps are others."""
    return lambda rows, on, s, rng: replace(rows, t_s=rows.t_s + np.where(on, off_s(s, rng), 0))


_LOST, _HALVED, _TWICE = _kept(lambda k, rng: 0), _kept(lambda k, rng: k % 2 == 0), _kept(lambda k, rng: 2)


def _thinned(share: float) -> Damage:
    return _kept(lambda k, rng: rng.random(len(k)) >= share)


def _bursts(each_s: float) -> Damage:
    """Held up, then all at once, again and again."""
    return _arriving(lambda s, rng: each_s * np.ceil((s + 1e-9) / each_s) - s)


def _later(seconds: float) -> Damage:
    return _arriving(lambda s, rng: seconds)


def _disorder(seconds: float) -> Damage:
    """Each row late by a time of its own."""
    return _arriving(lambda s, rng: rng.uniform(0.0, seconds, len(s)))


def _clock(seconds: float) -> Damage:
    """The clock of the stamps is set forward (or back)."""
    return _stamped(lambda s, rng: seconds)


def _single_stamps(s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One stamp in fifty is wrong by a second."""
    return np.where(rng.random(len(s)) < 0.02, rng.choice([-1.0, 1.0], len(s)), 0.0)


EVER = np.inf
_imu, _frames = partial(Fault, "imu"), partial(Fault, "frames")
#: Every kind: what it is called, and its faults. The first has none.
KINDS: dict[str, list[Fault]] = {
    "nothing wrong": [],
    "IMU held for 1 s": [_imu(1.0, _values(lambda r, a, g: _hold(a, g)))],
    "gyroscope held for 1 s": [_imu(1.0, _values(lambda r, a, g: _hold(g)))],
    "accelerometer held for 1 s": [_imu(1.0, _values(lambda r, a, g: _hold(a)))],
    "spikes of 30 m/s^2 and of 30 rad/s, 1 % each": [
        _imu(5.0, _values(lambda r, a, g: _spikes(a, 30.0, r))),
        _imu(5.0, _values(lambda r, a, g: _spikes(g, 30.0, r))),
    ],
    "accelerometer spikes of 100 m/s^2, 1 %": [_imu(5.0, _values(lambda r, a, g: _spikes(a, 100.0, r)))],
    "IMU of 1e6 for 1 s": [_imu(1.0, _values(lambda r, a, g: _scale(1e6, a, g)))],
    "IMU ten times too large for 1 s": [_imu(1.0, _values(lambda r, a, g: _scale(10.0, a, g)))],
    "IMU zero for 1 s": [_imu(1.0, _values(lambda r, a, g: _scale(0.0, a, g)))],
    "IMU nan for 1 s": [_imu(1.0, _values(lambda r, a, g: _scale(np.nan, a, g)))],
    "accelerometer clips at 12 m/s^2": [_imu(5.0, _values(lambda r, a, g: np.clip(a, -12, 12, out=a)))],
    "gyroscope clips at 2 rad/s": [_imu(5.0, _values(lambda r, a, g: np.clip(g, -2, 2, out=g)))],
    "accelerometer in g from then on": [_imu(EVER, _values(lambda r, a, g: _scale(1 / GRAVITY, a)))],
    "gyroscope in deg/s from then on": [_imu(EVER, _values(lambda r, a, g: _scale(180 / np.pi, g)))],
    "IMU pauses 0.2 s": [_imu(0.2, _LOST)],
    "IMU away for 1 s": [_imu(1.0, _LOST)],
    "IMU away for 5 s": [_imu(5.0, _LOST)],
    "IMU restarts after 2 s, with a clock of its own": [_imu(2.0, _LOST), _imu(EVER, _clock(5000.0))],
    "IMU loses 20 % of its samples": [_imu(EVER, _thinned(0.2))],
    "IMU in bursts of 0.4 s": [_imu(4.0, _bursts(0.4))],
    "IMU 0.15 s later": [_imu(EVER, _later(0.15))],
    "IMU clock set forward 0.1 s": [_imu(EVER, _clock(0.1))],
    "IMU clock set back 0.1 s": [_imu(EVER, _clock(-0.1))],
    "IMU clock set forward 2 s": [_imu(EVER, _clock(2.0))],
    "IMU clock set back 2 s": [_imu(EVER, _clock(-2.0))],
    "single IMU stamps wrong": [_imu(EVER, _stamped(_single_stamps))],
    "camera frozen for 5 s": [_frames(5.0, _values(lambda r, p: _hold(p)))],
    "camera frozen with noise for 5 s": [_frames(5.0, _values(_noisy_hold))],
    "other body 1 m away for 3 s": [_frames(3.0, _values(lambda r, p: np.add(p, [1.0, 0, 0], out=p)))],
    "child 0.6 m away for 3 s": [_frames(3.0, _values(_shorter))],
    "joints guessed at the hip for 3 s": [_frames(3.0, _values(_at_the_hip))],
    "other arm for 3 s": [_frames(3.0, _values(_other_arm))],
    "joints jump, 5 %": [_frames(5.0, _values(_jumps))],
    "camera nan for 2 s": [_frames(2.0, _values(lambda r, p: p.fill(np.nan)))],
    "camera in mm from then on": [_frames(EVER, _values(lambda r, p: _scale(1000.0, p)))],
    "camera away for 3 s": [_frames(3.0, _LOST)],
    "camera restarts after 2 s, with a clock of its own": [
        _frames(2.0, _LOST),
        _frames(EVER, _clock(5000.0)),
    ],
    "frames in bursts of 0.5 s": [_frames(4.0, _bursts(0.5))],
    "frames 0.1 s later": [_frames(EVER, _later(0.1))],
    "frames 0.1 s later for 5 s": [_frames(5.0, _later(0.1))],
    "camera clock set forward 0.3 s": [_frames(EVER, _clock(0.3))],
    "camera clock set back 0.3 s": [_frames(EVER, _clock(-0.3))],
    "camera clock set forward 0.05 s": [_frames(EVER, _clock(0.05))],
    "camera clock set back 2 s": [_frames(EVER, _clock(-2.0))],
    "both rates halved": [_imu(EVER, _HALVED), _frames(EVER, _HALVED)],
    "samples and frames twice": [_imu(EVER, _TWICE), _frames(EVER, _TWICE)],
    "samples in disorder, 0.3 s, and frames, 0.2 s": [
        _imu(EVER, _disorder(0.3)),
        _frames(EVER, _disorder(0.2)),
    ],
    "both away for 3 s": [_imu(3.0, _LOST), _frames(3.0, _LOST)],
}


def damaged(streams: Streams, faults: list[Fault], rng: np.random.Generator, segment: str) -> Streams:
    """Streams with faults; those of the IMU may be of another segment's."""
    found = dict(streams)
    for fault in faults:
        at = segment if fault.stream == "imu" else fault.stream
        s = found[at].arrival_s - AT_S
        found[at] = fault.damage(found[at], (s >= 0) & (s < fault.length_s), s, rng)
    return found


def imu_rows(imu: ImuStream) -> ImuRows:
    """Samples by threes, as they are taken."""
    t = np.asarray(imu.t_s, float)
    last = np.minimum((np.arange(len(t)) // TOGETHER + 1) * TOGETHER - 1, len(t) - 1)
    return ImuRows(t, np.array(imu.acc, float), np.array(imu.gyro, float), t[last] + 0.004)


class Sound(Playback):
    """A sound session until faults begin, which branch off, each in a process."""

    def __init__(self, preset: str = "realistic", imus: str = "wrist", seed: int = 1) -> None:
        made = {"protocol": "random", "imu_rate_hz": 100, "occlusion_lengths_s": (1.0,), "imus": imus}
        self.seed = seed
        self.made: SimulatedArm = simulate_arm(ArmSimulation.preset(preset, duration_s=32.0, **made), seed)
        recording = self.made.recording
        arm, t_s = recording.arm, np.asarray(recording.arm.t_s, float)
        frames = FrameRows(t_s, np.array(arm.position), np.array(arm.state), t_s + OFFSET_S + LATENCY_S)
        further = {segment: imu_rows(each) for segment, each in recording.further_imus.items()}
        self.streams: Streams = {FOREARM.name: imu_rows(recording.imu), **further, "frames": frames}
        axes = recording.camera_frame
        names = {FOREARM.name: "imu"} | {segment: segment for segment in further}
        info = SourceInfo(names, "camera", recording.side, (), 0, axes, recording.gravity_hint)
        super().__init__([info], [arrivals_of(self.streams)], speed=0.0, step_s=STEP_S)
        self.outputs: list[LiveOutput] = []
        self.events: list[tuple[float, str]] = []  # when, and what was said
        calibrator = InlineCalibrator(15)
        engine = LiveSmoother(recording.side, camera_frame=axes, calibrator=calibrator, further=list(further))
        self._session = LiveSession(self, [engine], receivers=[self])
        self._session.run(lambda: self.now_s() >= AT_S - STEP_S)

    def end_with(self, streams: Streams, end_s: float) -> None:
        """Go on with other streams, which are the same until now."""
        self.play([arrivals_of(streams)])
        self._session.run(lambda: self.now_s() >= end_s)

    def send(self, step: LiveStep) -> None:
        """Keep what was answered and said."""
        self.outputs.append(step.output)
        self.events += [(step.output.now_s, text) for text in step.events]

    def close(self) -> None:
        """Nothing to let go."""


def arrivals_of(streams: Streams) -> Arrivals:
    """The streams of an arm."""
    imus: Any = {name: rows for name, rows in streams.items() if name != "frames"}
    frames: Any = streams["frames"]
    return Arrivals(imus, frames)


sound: Sound  # of the seed at work; workers are forked with it


def verdict(kind: str, segment: str = FOREARM.name) -> tuple[list[float], list[str]]:
    """Of a kind of fault: its row of figures, and what was said; in a process of its own."""
    with multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply_async(_verdict, (kind, segment)).get(LONGEST_S)


def _verdict(kind: str, segment: str) -> tuple[list[float], list[str]]:
    faults, rng = KINDS[kind], np.random.default_rng([sound.seed, sum(kind.encode())])
    last_s = max((fault.length_s for fault in faults if fault.length_s < EVER), default=0.0)
    sound.end_with(damaged(sound.streams, faults, rng, segment), AT_S + last_s + AFTER_S)
    answers = [(each.now_s, each.now) for each in sound.outputs]
    t = np.array([now_s for now_s, _ in answers])
    error, sigma, visible = np.full((3, len(t)), np.nan)
    for row, now in ((row, now) for row, (_, now) in enumerate(answers) if now is not None):
        true = sound.made.motion.imu_pose(np.array([now.t_s]))[1][0]
        error[row], sigma[row] = np.linalg.norm(now.position - true), now.sigma_m
        visible[row] = now.state is LiveState.VISIBLE
    worst, last = int(np.nanargmax(error / sigma)), (visible > 0) & (t > t[-1] - 5.0)
    said = [(when - AT_S, text) for when, text in sound.events if when > AT_S]
    usual = {each.doubt for each in sound.outputs if each.now_s <= AT_S}
    doubts = [each.now_s - AT_S for each in sound.outputs if each.now_s > AT_S and each.doubt not in usual]
    row = [
        float((error > SIGMAS * sigma).sum() * STEP_S),
        float((np.isnan(error) & (t > AT_S)).sum() * STEP_S),
        100 * float(error[worst]),
        100 * float(sigma[worst]),
        float(100 * np.sqrt(np.mean(error[last] ** 2))) if last.any() else float("nan"),
        min([when for when, _ in said] + doubts, default=float("nan")),
    ]
    return row, [f"{when:+.1f} s: {text}" for when, text in said]


def main() -> int:
    """Run the kinds, and print the table."""
    global sound
    parser = argparse.ArgumentParser(prog="python -m tools.live_faults", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--only", nargs="+", default=[""], help="kinds whose name contains one of these")
    parser.add_argument("--preset", default="realistic", help="the camera")
    parser.add_argument("--imus", default="wrist", help="where IMUs are worn, as `simulate arm --imus`")
    parser.add_argument("--on", default=FOREARM.name, help="the segment whose IMU is at fault: upper_arm")
    parser.add_argument("--say", action="store_true", help="print all that the session said")
    options = parser.parse_args()
    bad = set()
    print(f"{'kind':51} seed  wrong s   no answer  worst cm  sigma  end cm  said s  what")
    kinds = [kind for kind in KINDS if any(text in kind for text in options.only)]
    for seed in options.seeds:
        sound = Sound(options.preset, options.imus, seed)
        for kind in kinds:
            row, said = verdict(kind, options.on)
            bad |= {kind} if row[0] > MOST_S else set()
            cells = "".join(f"{value:{width}}" for value, width in zip(row, WIDTHS, strict=True))
            mark = " <--" if row[0] > MOST_S else ""
            print(f"{kind:51} {seed:4} {cells}  {said[0] if said else '-'}{mark}", flush=True)
            if options.say:
                print(*(f"    {line}" for line in said), sep="\n", flush=True)
    print(f"{len(bad)} of {len(kinds)} kinds are wrong for more than {MOST_S:g} s")
    return 1 if bad else 0


#: Of the table's columns.
WIDTHS = ("8.2f", "12.2f", "10.1f", "7.1f", "8.1f", "8.2f")

if __name__ == "__main__":
    sys.exit(main())
