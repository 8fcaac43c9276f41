"""The pictures of the documents, drawn from real runs: `python -m tools.figures [picture|tutorial]`.

docs/picture.svg: one occlusion of data/demo.mcap before and after, with nothing calibrated. The SVG is
written by hand, so that the picture needs no plotting library. (The README's picture,
docs/pictures/body.webp, is the animation in that recording's report at 5.25 s.)

docs/pictures, for the tutorial: `gap.svg` and `sigma.svg` are of a real run on the recording that it
simulates; `report.webp` is a photograph of its report, where Chromium is installed. (`setup.svg` and
`movements.svg` beside them are drawings.)
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smoother import read_recording
from smoother.array_types import FloatArray
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth

HERE = Path(__file__).parents[1]
CHAIN = ("shoulder", "elbow", "wrist", "hand")
SEEN, RECOVERED, TRUTH, GAP, FRAME, TEXT = "#1a6fb5", "#d9650b", "#222222", "#f3e9dc", "#bbbbbb", "#333333"
#: Time shown around the gap, s; how often the arm is drawn, s.
AROUND_S, EVERY_S = 1.2, 0.15


@dataclass
class Panel:
    """A rectangle of the picture with its own scales."""

    left: float
    top: float
    width: float
    height: float
    x_range: tuple[float, float]
    y_range: tuple[float, float]

    def place(self, x: FloatArray, y: FloatArray) -> list[tuple[float, float]]:
        """Pixels of points; y grows upwards."""
        (x0, x1), (y0, y1) = self.x_range, self.y_range
        across = self.left + (np.asarray(x) - x0) / (x1 - x0) * self.width
        down = self.top + self.height - (np.asarray(y) - y0) / (y1 - y0) * self.height
        return [(float(a), float(b)) for a, b in zip(across, down, strict=True)]

    def frame(self) -> str:
        """Its border."""
        return (
            f'<rect x="{self.left:g}" y="{self.top:g}" width="{self.width:g}" height="{self.height:g}" '
            f'fill="none" stroke="{FRAME}"/>'
        )

    def box(self, x0: float, x1: float, color: str) -> str:
        """A shaded stretch of x over the whole height."""
        (a, _), (b, _) = self.place(np.array([x0, x1]), np.full(2, self.y_range[0]))
        return (
            f'<rect x="{a:.1f}" y="{self.top:g}" width="{b - a:.1f}" height="{self.height:g}" '
            f'fill="{color}"/>'
        )


def line(points: Sequence[tuple[float, float]], color: str, width: float = 2.0, extra: str = "") -> str:
    """An open line."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return (
        f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="{width:g}" '
        f'stroke-linejoin="round" stroke-linecap="round" {extra}/>'
    )


def area(points: Sequence[tuple[float, float]], color: str) -> str:
    """A filled outline."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polygon points="{path}" fill="{color}" fill-opacity="0.25" stroke="none"/>'


def dots(points: Iterable[tuple[float, float]], color: str, radius: float = 2.0) -> str:
    """Small discs."""
    return "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="{color}"/>' for x, y in points)


def text(x: float, y: float, words: str, size: int = 13, extra: str = "") -> str:
    """A line of text."""
    return f'<text x="{x:g}" y="{y:g}" font-size="{size}" fill="{TEXT}" {extra}>{words}</text>'


def arms(panel: Panel, joints: dict[str, FloatArray], color: str, opacity: float) -> str:
    """The arm from shoulder to hand at several instants: joints (n, 3) by name, nan where unknown."""
    drawn = []
    for k in range(len(joints["wrist"])):
        chain = np.array([joints[joint][k] for joint in CHAIN])
        chain = chain[np.isfinite(chain).all(axis=1)]
        if len(chain) >= 2:
            points = panel.place(-chain[:, 0], chain[:, 1])  # Kinect's x points left
            drawn.append(line(points, color, 2.2, f'stroke-opacity="{opacity:g}"'))
    return "".join(drawn)


def picture(recording: Recording, recovery: Recovery, number: int) -> str:
    """The picture of one gap."""
    gap, truth = recovery.gaps[number], recording.truth
    assert truth is not None
    start, end = gap.start_s - AROUND_S, gap.end_s + AROUND_S
    camera, t = recovery.arm, recovery.t_s
    wrist, true = recovery.joints["wrist"], truth.joints["wrist"]
    spread = np.sqrt(recovery.joint_covariance["wrist"][:, 1, 1])
    shown = (t >= start) & (t <= end)
    frames = (camera.t_s >= start) & (camera.t_s <= end)

    instants = np.arange(start, end, EVERY_S)
    at_frame = np.abs(camera.t_s[:, None] - instants).argmin(axis=0)
    at_sample = np.abs(t[:, None] - instants).argmin(axis=0)
    hidden = (instants > gap.start_s) & (instants < gap.end_s)
    before = {
        joint: np.where(camera.tracked(joint)[:, None], camera.joint(joint), np.nan)[at_frame]
        for joint in CHAIN
    }
    before["elbow"][hidden] = np.nan
    after = {joint: recovery.joints[joint][at_sample] for joint in CHAIN}

    shoulder = after["shoulder"][:, :2].mean(axis=0)
    everything = np.concatenate([each for each in after.values()])
    middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    half = 0.64 * float(np.ptp(everything[:, :2], axis=0).max())
    wide = half * 380 / 330
    across, up = (-middle[0] - wide, -middle[0] + wide), (middle[1] - half, middle[1] + half)
    heights = np.concatenate([wrist[shown, 1], true[shown, 1]])
    height = (float(heights.min()) - 0.08, float(heights.max()) + 0.08)

    parts = []
    for column, name in enumerate(("What the camera gives", "What comes out")):
        left = 60 + 440 * column
        view = Panel(left, 50, 380, 330, across, up)
        plot = Panel(left, 420, 380, 170, (start, end), height)
        parts += [text(left, 36, name, 17, 'font-weight="bold"'), view.frame()]
        parts += [plot.box(gap.start_s, gap.end_s, GAP), plot.frame()]
        seen = {joint: each[~hidden] for joint, each in (before if column == 0 else after).items()}
        parts.append(arms(view, seen, SEEN, 0.75))
        ticks = np.arange(np.ceil(height[0] * 5) / 5, height[1], 0.2)
        for tick, (_, y) in zip(ticks, plot.place(np.full(len(ticks), start), ticks), strict=True):
            parts.append(text(left - 6, y + 4, f"{tick:.1f}", 11, 'text-anchor="end"'))
        for second in range(int(np.ceil(start)), int(end) + 1):
            ((x, y),) = plot.place(np.array([second]), np.array([height[0]]))
            parts.append(text(x, y + 16, f"{second} s", 11, 'text-anchor="middle"'))
        rows = frames & camera.tracked("wrist")
        if column == 0:
            parts.append(dots(plot.place(camera.t_s[rows], camera.joint("wrist")[rows, 1]), SEEN))
            ((x, y),) = plot.place(np.array([0.5 * (gap.start_s + gap.end_s)]), np.array([np.mean(height)]))
            parts.append(text(x, y, "forearm hidden", 14, 'text-anchor="middle"'))
        else:
            parts.append(arms(view, {joint: each[hidden] for joint, each in after.items()}, RECOVERED, 0.8))
            upper = plot.place(t[shown], wrist[shown, 1] + 2 * spread[shown])
            lower = plot.place(t[shown], wrist[shown, 1] - 2 * spread[shown])
            parts.append(area(upper + lower[::-1], RECOVERED))
            occluded = shown & recovery.occluded
            for part, color in (
                (shown & (t <= gap.start_s), SEEN),
                (shown & (t >= gap.end_s), SEEN),
                (occluded, RECOVERED),
            ):
                parts.append(line(plot.place(t[part], wrist[part, 1]), color, 2.5))
            inside = (truth.t_s >= start) & (truth.t_s <= end)
            parts.append(
                line(plot.place(truth.t_s[inside], true[inside, 1]), TRUTH, 1.2, 'stroke-dasharray="4 4"')
            )
        ((x, y),) = view.place(*(np.array([each]) for each in shoulder * [-1, 1]))
        parts.append(text(x + 14, y + 14, "shoulder", 12))
    parts.append(text(60, 406, "Height of the wrist, m", 12))
    parts.append(text(500, 406, "Height of the wrist, m, with +- 2 sigma; dashed: truth", 12))
    key = (
        (60, SEEN, "arm seen, every 0.15 s, from the camera's side"),
        (500, RECOVERED, "arm recovered while hidden"),
    )
    for x, color, words in key:
        parts.append(line([(x + 8, 66), (x + 32, 66)], color, 3))
        parts.append(text(x + 40, 70, words, 12))
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 900 625" font-family="sans-serif" role="img">'
        "<title>An arm behind the head: hidden from the camera, and recovered</title>"
        '<rect width="900" height="625" fill="white"/>' + "\n".join(parts) + "</svg>\n"
    )


def draw(output: Path, gap: int) -> None:
    """Recover the demo recording and draw one of its gaps, counted from 0."""
    recording = read_recording(HERE / "data" / "demo.mcap")
    recovery = smooth(replace(recording, truth=None))
    output.write_text(picture(recording, recovery, gap), encoding="utf-8")
    print(f"written: {output}")


def drawn(width: int, height: int, title: str, parts: list[str]) -> str:
    """An SVG file of parts on white."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'font-family="sans-serif" role="img"><title>{title}</title>'
        f'<rect width="{width}" height="{height}" fill="white"/>' + "\n".join(parts) + "</svg>\n"
    )


#: `unocclude simulate arm --preset realistic --seed 7`: the tutorial's recording.
PRESET, SEED = "realistic", 7
#: Visible time beside a gap that is drawn, s.
AROUND_GAP_S = 1.5
#: What Chromium needs to take a photograph without a screen, and to leave everything else alone.
CHROMIUM = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars"),
    *("--disable-background-networking", "--window-size=1200,1250", "--virtual-time-budget=15000"),
)


def height_axis(panel: Panel, step: float, digits: int) -> list[str]:
    """Labels of the heights and of whole seconds."""
    (start, end), (low, high) = panel.x_range, panel.y_range
    parts = []
    for tick in np.arange(np.ceil(low / step) * step, high, step):
        ((x, y),) = panel.place(np.array([start]), np.array([tick]))
        parts += [
            line([(x - 5, y), (x, y)], FRAME, 1),
            text(x - 8, y + 4, f"{tick:.{digits}f}", 12, 'text-anchor="end"'),
        ]
    every = 1 if end - start < 10 else 5
    for second in range(int(np.ceil(start)), int(end) + 1):
        if second % every == 0:
            ((x, y),) = panel.place(np.array([second]), np.array([low]))
            parts += [
                line([(x, y), (x, y + 5)], FRAME, 1),
                text(x, y + 20, f"{second} s", 12, 'text-anchor="middle"'),
            ]
    return parts


def gap_drawing(recording: Recording, recovery: Recovery) -> str:
    """The height of the wrist about the first gap: camera, answer with two sigmas, truth."""
    truth, gap = recording.truth, recovery.gaps[0]
    assert truth is not None
    t, wrist = recovery.t_s, recovery.joints["wrist"][:, 1]
    spread = 2 * np.sqrt(recovery.joint_covariance["wrist"][:, 1, 1])
    shown = (t > gap.start_s - AROUND_GAP_S) & (t < gap.end_s + AROUND_GAP_S)
    panel = Panel(70, 30, 700, 260, (float(t[shown][0]), float(t[shown][-1])), limits(wrist[shown]))
    seen = (
        recovery.arm.tracked("wrist") & (recovery.arm.t_s > t[shown][0]) & (recovery.arm.t_s < t[shown][-1])
    )
    upper = panel.place(t[shown], wrist[shown] + spread[shown])
    lower = panel.place(t[shown], wrist[shown] - spread[shown])
    true = np.interp(t[shown], truth.t_s, truth.joints["wrist"][:, 1])
    parts = [panel.box(gap.start_s, gap.end_s, GAP), panel.frame(), *height_axis(panel, 0.1, 1)]
    parts += [area(upper + lower[::-1], RECOVERED), line(panel.place(t[shown], wrist[shown]), RECOVERED, 2.5)]
    parts += [dots(panel.place(recovery.arm.t_s[seen], recovery.arm.joint("wrist")[seen, 1]), SEEN, 2.5)]
    parts += [line(panel.place(t[shown], true), TRUTH, 1.2, 'stroke-dasharray="4 4"')]
    parts += [
        text(
            70,
            20,
            "Height of the wrist, m: camera (blue), recovered with +- 2 sigma (orange), truth (dashed)",
            14,
        )
    ]
    return drawn(800, 325, "The wrist through a gap", parts)


def limits(values: FloatArray) -> tuple[float, float]:
    """Least and largest value with some air."""
    air = 0.12 * float(np.ptp(values))
    return float(values.min()) - air, float(values.max()) + air


def sigma_drawing(recovery: Recovery) -> str:
    """Sigma of the wrist over the recording."""
    t = recovery.t_s
    sigma_cm = 100 * np.sqrt(np.einsum("nii->ni", recovery.joint_covariance["wrist"])).max(axis=1)
    panel = Panel(70, 30, 700, 170, (float(t[0]), float(t[-1])), (0.0, 1.15 * float(sigma_cm.max())))
    parts = [panel.box(gap.start_s, gap.end_s, GAP) for gap in recovery.gaps]
    parts += [
        panel.frame(),
        *height_axis(panel, 0.5, 1),
        line(panel.place(t[::4], sigma_cm[::4]), RECOVERED, 2),
    ]
    parts += [text(70, 20, "Sigma of the wrist, cm (worst axis); shaded: the forearm is hidden", 14)]
    return drawn(800, 235, "Sigma over the recording", parts)


def photograph(page: Path, output: Path) -> bool:
    """A picture of the top of a page as a browser shows it; False where there is no browser."""
    from PIL import Image

    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        return False
    with tempfile.TemporaryDirectory() as folder:
        png = Path(folder) / "page.png"
        own = (f"--user-data-dir={folder}/profile", f"--screenshot={png}")
        subprocess.run([browser, *CHROMIUM, *own, page.resolve().as_uri()], check=True, capture_output=True)
        with Image.open(png) as image:
            image.convert("RGB").resize((960, 1000)).save(output, quality=78, method=6)
    return True


def draw_tutorial(folder: Path) -> None:
    """Make all pictures of the tutorial in a folder."""
    from smoother.report import write_report

    folder.mkdir(parents=True, exist_ok=True)
    recording = simulate_arm(ArmSimulation.preset(PRESET), SEED).recording
    recovery = smooth(recording)
    pictures = {
        "gap": gap_drawing(recording, recovery),
        "sigma": sigma_drawing(recovery),
    }
    for name, picture in pictures.items():
        (folder / f"{name}.svg").write_text(picture, encoding="utf-8")
    with tempfile.TemporaryDirectory() as temporary:
        page = Path(temporary) / "report.html"
        write_report(recovery, page, recording=recording)
        if not photograph(page, folder / "report.webp"):
            print("report.webp was left as it is: it needs Chromium")
    print(f"written: {folder}")


def main() -> None:
    """Draw what is named; everything where nothing is."""
    wanted = sys.argv[1:] or ["picture", "tutorial"]
    if "picture" in wanted:
        draw(HERE / "docs" / "picture.svg", 0)
    if "tutorial" in wanted:
        draw_tutorial(HERE / "docs" / "pictures")


if __name__ == "__main__":
    main()
