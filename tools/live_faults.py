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
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from smoother.body import FOREARM
from smoother.live.answers import LiveOutput, LiveState
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.recording import JOINTS, ImuStream
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.streams.arrivals import Arrivals, LiveStep, Rows, SourceInfo
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

#: Rows by stream: IMUs by segment, the forearm's first, and "frames".
Streams = dict[str, Rows]
#: Of rows, which are at fault, when each arrives after the fault began (s), and random numbers: other rows.
Damage = Callable[[Rows, np.ndarray, np.ndarray, np.random.Generator], Rows]
#: Of the values of a column at fault and random numbers: other values.
Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def values(**changes: Change) -> Damage:
    """Other values in some columns."""

    def damage(rows: Rows, on: np.ndarray, s: np.ndarray, rng: np.random.Generator) -> Rows:
        columns = dict(rows.columns)
        for name, change in changes.items():
            columns[name] = columns[name].copy()
            columns[name][on] = change(columns[name][on], rng)
        return replace(rows, columns=columns)

    return damage


def both(change: Change) -> Damage:
    """The same with the values of accelerometer and gyroscope."""
    return values(acc=change, gyro=change)


def hold(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.repeat(values[:1], len(values), axis=0)


def scale(factor: float) -> Change:
    return lambda values, rng: factor * values


def spikes(size: float) -> Change:
    def change(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        hit = rng.random(len(values)) < 0.01
        axes = rng.normal(size=(int(hit.sum()), 3))
        values[hit] += size * axes / np.linalg.norm(axes, axis=1)[:, None]
        return values

    return change


def shorter(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A child 0.6 m beside: every bone a quarter shorter."""
    middle = position[:, [JOINTS.index("shoulder")]]
    return middle + 0.75 * (position - middle) + np.array([0.6, 0.0, 0.0])


def at_the_hip(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Elbow and wrist guessed: beside the trunk, a little noise."""
    shoulder, noise = JOINTS.index("shoulder"), rng.normal(scale=0.005, size=(len(position), 2, 3))
    for place, (joint, down_m) in enumerate((("elbow", 0.28), ("wrist", 0.52))):
        column = JOINTS.index(joint)
        off, sunk = position[:, column] - position[:, shoulder], np.zeros(3)
        sunk[int(np.argmax(np.abs(np.nanmean(off[:, :2], axis=0))))] = 0.05
        sunk[1] += down_m
        position[:, column] = position[:, shoulder] + sunk + noise[:, place]
    return position


def jumps(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One frame in twenty is half a metre off."""
    hit = rng.random(len(position)) < 0.05
    position[hit] += rng.choice([-0.5, 0.5], (int(hit.sum()), 1, 3))
    return position


def times(wanted: Callable[[np.ndarray, np.random.Generator], Any]) -> Damage:
    """Each of the rows at fault comes as often as is said."""
    return lambda rows, on, s, rng: rows.select(
        np.repeat(np.arange(len(on)), np.where(on, wanted(np.arange(len(on)), rng), 1))
    )


def later(by_s: Callable[[np.ndarray, np.random.Generator], Any]) -> Damage:
    """The stamps stay right, the arrivals are later."""
    return lambda rows, on, s, rng: replace(rows, arrival_s=rows.arrival_s + np.where(on, by_s(s, rng), 0))


def stamped(off_s: Callable[[np.ndarray, np.random.Generator], Any]) -> Damage:
    """The arrivals stay right, the stamps are others."""
    return lambda rows, on, s, rng: replace(rows, t_s=rows.t_s + np.where(on, off_s(s, rng), 0))


def clock(seconds: float) -> Damage:
    """The clock of the stamps is set forward (or back)."""
    return stamped(lambda s, rng: seconds)


def bursts(each_s: float) -> Damage:
    """Held up, then all at once, again and again."""
    return later(lambda s, rng: each_s * np.ceil((s + 1e-9) / each_s) - s)


def disorder(seconds: float) -> Damage:
    """Each row late by a time of its own."""
    return later(lambda s, rng: rng.uniform(0.0, seconds, len(s)))


def single_stamps(s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One stamp in fifty is wrong by a second."""
    return np.where(rng.random(len(s)) < 0.02, rng.choice([-1.0, 1.0], len(s)), 0.0)


EVER = np.inf
LOST, HALVED, TWICE = times(lambda k, rng: 0), times(lambda k, rng: k % 2 == 0), times(lambda k, rng: 2)
NOISY = values(position=lambda p, rng: p[:1] + rng.normal(scale=0.003, size=p.shape))
BESIDE = np.array([0.36, 0.0, 0.0])  # the other arm, which hangs still
#: Every kind: what it is called, and its faults, each a stream, for how long (s), and what happens to it.
KINDS: dict[str, list[tuple[str, float, Damage]]] = {
    "nothing wrong": [],
    "IMU held for 1 s": [("imu", 1.0, both(hold))],
    "gyroscope held for 1 s": [("imu", 1.0, values(gyro=hold))],
    "accelerometer held for 1 s": [("imu", 1.0, values(acc=hold))],
    "spikes of 30 m/s^2 and of 30 rad/s, 1 % each": [("imu", 5.0, both(spikes(30.0)))],
    "accelerometer spikes of 100 m/s^2, 1 %": [("imu", 5.0, values(acc=spikes(100.0)))],
    "IMU of 1e6 for 1 s": [("imu", 1.0, both(scale(1e6)))],
    "IMU ten times too large for 1 s": [("imu", 1.0, both(scale(10.0)))],
    "IMU zero for 1 s": [("imu", 1.0, both(scale(0.0)))],
    "IMU nan for 1 s": [("imu", 1.0, both(scale(np.nan)))],
    "accelerometer clips at 12 m/s^2": [("imu", 5.0, values(acc=lambda a, rng: a.clip(-12, 12)))],
    "gyroscope clips at 2 rad/s": [("imu", 5.0, values(gyro=lambda g, rng: g.clip(-2, 2)))],
    "accelerometer in g from then on": [("imu", EVER, values(acc=scale(1 / GRAVITY)))],
    "gyroscope in deg/s from then on": [("imu", EVER, values(gyro=scale(180 / np.pi)))],
    "IMU pauses 0.2 s": [("imu", 0.2, LOST)],
    "IMU away for 1 s": [("imu", 1.0, LOST)],
    "IMU away for 5 s": [("imu", 5.0, LOST)],
    "IMU restarts after 2 s, with a clock of its own": [("imu", 2.0, LOST), ("imu", EVER, clock(5000.0))],
    "IMU loses 20 % of its samples": [("imu", EVER, times(lambda k, rng: rng.random(len(k)) >= 0.2))],
    "IMU in bursts of 0.4 s": [("imu", 4.0, bursts(0.4))],
    "IMU 0.15 s later": [("imu", EVER, later(lambda s, rng: 0.15))],
    "IMU clock set forward 0.1 s": [("imu", EVER, clock(0.1))],
    "IMU clock set back 0.1 s": [("imu", EVER, clock(-0.1))],
    "IMU clock set forward 2 s": [("imu", EVER, clock(2.0))],
    "IMU clock set back 2 s": [("imu", EVER, clock(-2.0))],
    "single IMU stamps wrong": [("imu", EVER, stamped(single_stamps))],
    "camera frozen for 5 s": [("frames", 5.0, values(position=hold))],
    "camera frozen with noise for 5 s": [("frames", 5.0, NOISY)],
    "other body 1 m away for 3 s": [
        ("frames", 3.0, values(position=lambda p, rng: p + np.array([1.0, 0, 0])))
    ],
    "child 0.6 m away for 3 s": [("frames", 3.0, values(position=shorter))],
    "joints guessed at the hip for 3 s": [("frames", 3.0, values(position=at_the_hip))],
    "other arm for 3 s": [("frames", 3.0, values(position=lambda p, rng: p[0] + BESIDE + 0.1 * (p - p[0])))],
    "joints jump, 5 %": [("frames", 5.0, values(position=jumps))],
    "camera nan for 2 s": [("frames", 2.0, values(position=scale(np.nan)))],
    "camera in mm from then on": [("frames", EVER, values(position=scale(1000.0)))],
    "camera away for 3 s": [("frames", 3.0, LOST)],
    "camera restarts after 2 s, with a clock of its own": [
        ("frames", 2.0, LOST),
        ("frames", EVER, clock(5000.0)),
    ],
    "frames in bursts of 0.5 s": [("frames", 4.0, bursts(0.5))],
    "frames 0.1 s later": [("frames", EVER, later(lambda s, rng: 0.1))],
    "frames 0.1 s later for 5 s": [("frames", 5.0, later(lambda s, rng: 0.1))],
    "camera clock set forward 0.3 s": [("frames", EVER, clock(0.3))],
    "camera clock set back 0.3 s": [("frames", EVER, clock(-0.3))],
    "camera clock set forward 0.05 s": [("frames", EVER, clock(0.05))],
    "camera clock set back 2 s": [("frames", EVER, clock(-2.0))],
    "both rates halved": [("imu", EVER, HALVED), ("frames", EVER, HALVED)],
    "samples and frames twice": [("imu", EVER, TWICE), ("frames", EVER, TWICE)],
    "samples in disorder, 0.3 s, and frames, 0.2 s": [
        ("imu", EVER, disorder(0.3)),
        ("frames", EVER, disorder(0.2)),
    ],
    "both away for 3 s": [("imu", 3.0, LOST), ("frames", 3.0, LOST)],
}


def imu_rows(imu: ImuStream) -> Rows:
    """Samples by threes, as they are taken."""
    t = np.asarray(imu.t_s, float)
    last = np.minimum((np.arange(len(t)) // TOGETHER + 1) * TOGETHER - 1, len(t) - 1)
    return Rows(t, t[last] + 0.004, {"acc": np.array(imu.acc, float), "gyro": np.array(imu.gyro, float)})


class Sound(Playback):
    """A sound session until faults begin, which branch off, each in a process."""

    def __init__(self, preset: str = "realistic", imus: str = "wrist", seed: int = 1) -> None:
        settings = {"protocol": "random", "imu_rate_hz": 100, "occlusion_lengths_s": (1.0,), "imus": imus}
        self.seed = seed
        self.made: SimulatedArm = simulate_arm(
            ArmSimulation.preset(preset, duration_s=32.0, **settings), seed
        )
        recording = self.made.recording
        arm, t_s = recording.arm, np.asarray(recording.arm.t_s, float)
        seen = {"position": np.array(arm.position), "state": np.array(arm.state)}
        worn = {FOREARM.name: recording.imu, **recording.further_imus}
        self.streams: Streams = {segment: imu_rows(each) for segment, each in worn.items()}
        self.streams["frames"] = Rows(t_s, t_s + OFFSET_S + LATENCY_S, seen)
        axes, names = recording.camera_frame, {segment: segment for segment in worn}
        info = SourceInfo(names, "camera", recording.side, (), 0, axes, recording.gravity_hint)
        super().__init__([info], [arrivals_of(self.streams)], speed=0.0, step_s=STEP_S)
        self.steps: list[LiveStep] = []
        self.send = self.steps.append
        further = list(recording.further_imus)
        calibrator = InlineCalibrator(15)
        engine = LiveSmoother(recording.side, camera_frame=axes, calibrator=calibrator, further=further)
        self._session = LiveSession(self, [engine], receivers=[self])
        self._session.run(lambda: self.now_s() >= AT_S - STEP_S)

    def end_with(self, streams: Streams, end_s: float) -> None:
        """Go on with other streams, which are the same until now."""
        self.play([arrivals_of(streams)])
        self._session.run(lambda: self.now_s() >= end_s)

    def close(self) -> None:
        """Nothing to let go."""


def arrivals_of(streams: Streams) -> Arrivals:
    return Arrivals({name: rows for name, rows in streams.items() if name != "frames"}, streams["frames"])


def damaged(
    streams: Streams, faults: list[tuple[str, float, Damage]], rng: np.random.Generator, segment: str
) -> Streams:
    """Streams with faults; those of the IMU may be of another segment's."""
    found = dict(streams)
    for stream, length_s, damage in faults:
        at = segment if stream == "imu" else stream
        s = found[at].arrival_s - AT_S
        found[at] = damage(found[at], (s >= 0) & (s < length_s), s, rng)
    return found


sound: Sound  # of the seed at work; workers are forked with it


def verdict(kind: str, segment: str = FOREARM.name) -> tuple[list[float], list[str]]:
    """Of a kind of fault: its row of figures, and what was said; in a process of its own."""
    with multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply_async(_verdict, (kind, segment)).get(LONGEST_S)


def _verdict(kind: str, segment: str) -> tuple[list[float], list[str]]:
    faults, rng = KINDS[kind], np.random.default_rng([sound.seed, sum(kind.encode())])
    last_s = max((length_s for _, length_s, _ in faults if length_s < EVER), default=0.0)
    sound.end_with(damaged(sound.streams, faults, rng, segment), AT_S + last_s + AFTER_S)
    outputs: list[LiveOutput] = [step.output for step in sound.steps]
    t = np.array([each.now_s for each in outputs])
    error, sigma, visible = np.full((3, len(t)), np.nan)
    for row, now in ((row, each.now) for row, each in enumerate(outputs) if each.now is not None):
        true = sound.made.motion.imu_pose(np.array([now.t_s]))[1][0]
        error[row], sigma[row] = np.linalg.norm(now.position - true), now.sigma_m
        visible[row] = now.state is LiveState.VISIBLE
    worst, last = int(np.nanargmax(error / sigma)), (visible > 0) & (t > t[-1] - 5.0)
    said = [(each.output.now_s - AT_S, text) for each in sound.steps for text in each.events]
    said = [(when, text) for when, text in said if when > 0.0]
    usual = {each.doubt for each in outputs if each.now_s <= AT_S}
    doubts = [each.now_s - AT_S for each in outputs if each.now_s > AT_S and each.doubt not in usual]
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
