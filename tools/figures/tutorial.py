"""The pictures of the tutorial, docs/pictures: how to set up, what to do in view, and what comes out.

`setup.svg` and `movements.svg` are drawings; `gap.svg` and `sigma.svg` are of a real run on the recording
that the tutorial simulates; `report.webp` is a photograph of its report, where Chromium is installed.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from smoother import smooth
from smoother.array_types import FloatArray
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm

from .drawings import drawn, movements_drawing, setup_drawing
from .picture import FRAME, GAP, RECOVERED, SEEN, TRUTH, Panel, area, dots, line, text

#: `unocclude simulate arm --preset realistic --seed 7`: the tutorial's recording.
PRESET, SEED = "realistic", 7
#: Visible time beside a gap that is drawn, s.
AROUND_S = 1.5
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
    shown = (t > gap.start_s - AROUND_S) & (t < gap.end_s + AROUND_S)
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


def draw(folder: Path) -> None:
    """Make all pictures of the tutorial in a folder."""
    from smoother.report import write_report

    folder.mkdir(parents=True, exist_ok=True)
    recording = simulate_arm(ArmSimulation.preset(PRESET), SEED).recording
    recovery = smooth(recording)
    pictures = {
        "setup": setup_drawing(),
        "movements": movements_drawing(),
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
