"""Measures of a stiff elbow: `python -m tools.reliability.elbow [--exercise pendulum] [--count N]`.

Noise can only bend a straight arm, so range and maximum of a straight elbow are biased unless that is counted
on. Each recording is smoothed with draws and measured as a user would; the table shows how far each measure
of the elbow's flexion is off the truth's, and how often its 95 % interval contains it.
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import numpy as np

from smoother.array_types import FloatArray
from smoother.linalg import unit
from smoother.measures import measure
from smoother.smoothing import smooth
from tools.reliability.scene import TRACKERS

from .judging import ONE_PROCESS
from .motions import EXERCISES, SPECIAL
from .scene import Scene, draw_scene

KEYS = ("range", "min", "max", "p5", "p50", "p95")


def true_flexion_deg(scene: Scene, t_s: FloatArray) -> FloatArray:
    """(N,) the angle between upper arm and forearm, 0 for a straight arm."""
    joints = scene.motion.joints(t_s)
    upper, fore = unit(joints["elbow"] - joints["shoulder"]), unit(joints["wrist"] - joints["elbow"])
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(upper, fore), axis=1), (upper * fore).sum(axis=1)))


def true_values(flexion_deg: FloatArray) -> dict[str, float]:
    """The measures of a known angle (N,)."""
    low, high = float(flexion_deg.min()), float(flexion_deg.max())
    percentiles = {f"p{p}": float(np.percentile(flexion_deg, p)) for p in (5, 50, 95)}
    return {"range": high - low, "min": low, "max": high, **percentiles}


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.reliability.elbow",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--exercise", choices=sorted({*EXERCISES, *SPECIAL}), default="pendulum")
    parser.add_argument(
        "--tracker", choices=sorted(TRACKERS), help="how well the camera sees; drawn without it"
    )
    parser.add_argument("--count", type=int, default=10, help="recordings")
    parser.add_argument("--seed", type=int, default=0, help="of all draws")
    parser.add_argument("--draws", type=int, default=64, help="of each motion")
    parser.add_argument("--held-out", action="store_true", help="the seeds that are kept for the end")
    options = parser.parse_args()
    family, found = int(options.held_out), defaultdict(list)
    rng = np.random.default_rng([options.seed, 6, family])
    for _ in range(options.count):
        seed, duration_s = int(rng.integers(2**31)), float(rng.uniform(20.0, 32.0))
        scene = draw_scene(options.exercise, duration_s, [seed, family], tracker_name=options.tracker)
        recovery = smooth(scene.recording(), None, ONE_PROCESS, draws=options.draws, seed=seed)
        true = true_values(true_flexion_deg(scene, recovery.t_s))
        rows = measure(recovery).by_key
        cells = []
        for key in KEYS:
            row = rows[f"elbow_flexion_{key}_deg"]
            holds = row.low is not None and row.high is not None and row.low <= true[key] <= row.high
            found[key].append((row.value - true[key], holds))
            cells.append(f"{key} {row.value:5.1f} for {true[key]:5.1f} {'holds' if holds else 'MISSES'}")
        verdict = "trusted" if recovery.estimates.trusted else "not trusted"
        print(f"{scene.tracker_name:9} {seed:10} {verdict:12} {', '.join(cells)}", flush=True)
    print(f"\n{options.exercise}: elbow flexion of {options.count} recordings, degrees")
    for key, values in found.items():
        off, held = (np.array(column) for column in zip(*values, strict=True))
        print(
            f"{key:6} bias {off.mean():+6.2f}  rms {np.sqrt((off**2).mean()):5.2f}"
            f"  95 % interval contains the truth: {100 * held.mean():3.0f} %"
        )


if __name__ == "__main__":
    main()
