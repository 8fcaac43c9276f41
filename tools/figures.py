"""The pictures of the documents, drawn from real runs: `python -m tools.figures [picture|tutorial]`.

docs/picture.svg: one occlusion of data/demo.mcap before and after, with nothing calibrated. (The README's
picture, docs/pictures/body.webp, is the animation in that recording's report at 5.25 s.)

docs/pictures, for the tutorial: `gap.svg` and `sigma.svg` are of a real run on the recording that it
simulates. (`report.webp` is a photograph of its report; `setup.svg` and `movements.svg` are drawings.)
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smoother import read_recording
from smoother.array_types import FloatArray
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth

DOCS = Path(__file__).parents[1] / "docs"
CHAIN = ("shoulder", "elbow", "wrist", "hand")
SEEN, RECOVERED, TRUTH, GAP = "#1a6fb5", "#d9650b", "#222222", "#f3e9dc"
#: Time shown around the gap, s; how often the arm is drawn, s.
AROUND_S, EVERY_S = 1.2, 0.15
#: `unocclude simulate arm --preset realistic --seed 7`: the tutorial's recording.
PRESET, SEED = "realistic", 7
# words stay words, and the same run draws the same file
mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "unocclude", "font.size": 10}


def save(figure: Figure, path: Path) -> None:
    figure.savefig(path, metadata={"Date": None})
    print(f"written: {path}")


def height(axes: Axes, recording: Recording, recovery: Recovery, around_s: float, recovered: bool) -> None:
    """The height of the wrist about the first gap: the camera's, or the answer with two sigmas and truth."""
    gap, truth, camera, t = recovery.gaps[0], recording.truth, recovery.arm, recovery.t_s
    assert truth is not None
    axes.axvspan(gap.start_s, gap.end_s, color=GAP)
    start_s, end_s = gap.start_s - around_s, gap.end_s + around_s
    rows = camera.tracked("wrist") & (camera.t_s > start_s) & (camera.t_s < end_s)
    axes.plot(camera.t_s[rows], camera.joint("wrist")[rows, 1], ".", color=SEEN)
    shown = (t > start_s) & (t < end_s)
    t, wrist = t[shown], recovery.joints["wrist"][shown, 1]
    if recovered:
        spread = 2 * np.sqrt(recovery.joint_covariance["wrist"][shown, 1, 1])
        true = np.interp(t, truth.t_s, truth.joints["wrist"][:, 1])
        axes.fill_between(t, wrist - spread, wrist + spread, color=RECOVERED, alpha=0.25, linewidth=0)
        axes.plot(t, wrist, color=RECOVERED)
        axes.plot(t, true, "--", color=TRUTH, linewidth=1)
    axes.set(xlim=(start_s, end_s), ylim=(wrist.min() - 0.08, wrist.max() + 0.08))
    axes.set(xlabel="time, s", ylabel="height of the wrist, m")


def arms(axes: Axes, joints: dict[str, FloatArray], rows: FloatArray, color: str) -> None:
    """The arm from shoulder to hand at some samples, from the camera's side (Kinect's x points left)."""
    for row in rows:
        chain = np.array([joints[joint][row] for joint in CHAIN])
        axes.plot(-chain[:, 0], chain[:, 1], color=color, alpha=0.75, solid_capstyle="round")


def draw_picture(path: Path) -> None:
    """The demo recording's first gap: what the camera gives, and what comes out."""
    recording = read_recording(DOCS.parent / "data" / "demo.mcap")
    recovery = smooth(replace(recording, truth=None))
    gap, camera = recovery.gaps[0], recovery.arm
    instants = np.arange(gap.start_s - AROUND_S, gap.end_s + AROUND_S, EVERY_S)
    hidden = (instants > gap.start_s) & (instants < gap.end_s)
    frame = np.abs(camera.t_s[:, None] - instants).argmin(axis=0)
    sample = np.abs(recovery.t_s[:, None] - instants).argmin(axis=0)
    seen = {joint: np.where(camera.tracked(joint)[:, None], camera.joint(joint), np.nan) for joint in CHAIN}
    figure = Figure(figsize=(9, 6.3), layout="constrained")
    ((before, after), below) = figure.subplots(2, 2, height_ratios=(2, 1), sharex="row", sharey="row")
    before.set_title("What the camera gives")
    after.set_title("What comes out")
    arms(before, seen, frame[~hidden], SEEN)
    arms(after, recovery.joints, sample[~hidden], SEEN)
    arms(after, recovery.joints, sample[hidden], RECOVERED)
    for axes, recovered in zip(below, (False, True), strict=True):
        height(axes, recording, recovery, AROUND_S, recovered)
    for axes in (before, after):
        axes.set(aspect="equal", xticks=[], yticks=[])
    below[0].set_title("gap: the forearm is hidden", fontsize="medium")
    below[1].set_title("recovered with ± 2 sigma; dashed: truth", fontsize="medium")
    save(figure, path)


def draw_tutorial(folder: Path) -> None:
    """All pictures of the tutorial."""
    recording = simulate_arm(ArmSimulation.preset(PRESET), SEED).recording
    recovery = smooth(recording)
    figure = Figure(figsize=(8, 3.3), layout="constrained")
    axes = figure.subplots()
    height(axes, recording, recovery, 1.5, recovered=True)
    axes.set_title("camera (blue), recovered with ± 2 sigma (orange), truth (dashed)", fontsize="medium")
    save(figure, folder / "gap.svg")
    figure = Figure(figsize=(8, 2.4), layout="constrained")
    axes = figure.subplots()
    for gap in recovery.gaps:
        axes.axvspan(gap.start_s, gap.end_s, color=GAP)
    variances = np.einsum("nii->ni", recovery.joint_covariance["wrist"])
    axes.plot(recovery.t_s[::4], 100 * np.sqrt(variances.max(axis=1))[::4], color=RECOVERED)
    axes.set(xlabel="time, s", ylabel="sigma of the wrist, cm", ylim=(0, None))
    axes.set_title("worst axis; shaded: the forearm is hidden", fontsize="medium")
    save(figure, folder / "sigma.svg")


if __name__ == "__main__":
    wanted = sys.argv[1:] or ["picture", "tutorial"]
    if "picture" in wanted:
        draw_picture(DOCS / "picture.svg")
    if "tutorial" in wanted:
        draw_tutorial(DOCS / "pictures")
