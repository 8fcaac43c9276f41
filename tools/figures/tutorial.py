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
from tools.figures.picture import FRAME, GAP, RECOVERED, SEEN, TEXT, TRUTH, Panel, area, dots, line, text

#: Of what is drawn of a person, besides the arm.
SKIN = "#8a8f98"


def drawn(width: int, height: int, title: str, parts: list[str]) -> str:
    """An SVG file of parts on white."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'font-family="sans-serif" role="img"><title>{title}</title>'
        f'<rect width="{width}" height="{height}" fill="white"/>' + "\n".join(parts) + "</svg>\n"
    )


def limb(points: list[tuple[float, float]], width: float = 9.0, colour: str = SKIN) -> str:
    """Part of a body: a thick line."""
    return line(points, colour, width)


def person(x: float, floor: float) -> list[str]:
    """Head, trunk and legs of a person who faces the camera on the left, seen from the side."""
    head = f'<circle cx="{x:g}" cy="{floor - 262:g}" r="24" fill="{SKIN}"/>'
    trunk = limb([(x, floor - 232), (x, floor - 120)], 22)
    return [
        head,
        trunk,
        limb([(x, floor - 120), (x - 10, floor)], 13),
        limb([(x, floor - 120), (x + 12, floor)], 13),
    ]


def sensor(x: float, y: float, turned_deg: float, colour: str) -> str:
    """An IMU in its case."""
    return (
        f'<rect x="{x - 9:g}" y="{y - 6:g}" width="18" height="12" rx="3" fill="{colour}" '
        f'stroke="white" transform="rotate({turned_deg:g} {x:g} {y:g})"/>'
    )


def setup_drawing() -> str:
    """Where camera and sensors go."""
    floor, x, camera_x = 330.0, 560.0, 110.0
    parts = [line([(30, floor), (770, floor)], FRAME, 2)]
    parts += [
        line([(camera_x, 175), (camera_x - 30, floor)], TEXT, 3),
        line([(camera_x, 175), (camera_x + 30, floor)], TEXT, 3),
    ]
    parts += [f'<rect x="{camera_x - 22:g}" y="150" width="44" height="26" rx="4" fill="{TEXT}"/>']
    parts += [line([(camera_x + 26, 163), (x - 60, 40)], FRAME, 1, 'stroke-dasharray="5 5"')]
    parts += [line([(camera_x + 26, 163), (x - 60, 318)], FRAME, 1, 'stroke-dasharray="5 5"')]
    parts += person(x, floor)
    shoulder, elbow, wrist, hand = (x, 105.0), (x - 42.0, 165.0), (x - 106.0, 132.0), (x - 130.0, 118.0)
    parts += [limb([shoulder, elbow], 13, SEEN), limb([elbow, wrist], 11, SEEN), limb([wrist, hand], 8, SEEN)]
    parts += [sensor(x - 99, 121, -27, RECOVERED), sensor(x - 13, 142, -55, "#e9b384")]
    parts.append(dots([shoulder, elbow, wrist, hand], TEXT, 4))
    parts += [
        line([(x - 101, 114), (x - 128, 48)], TEXT, 1),
        text(x - 222, 40, "IMU, on the back of the wrist", 14),
    ]
    parts += [line([(x - 8, 146), (x + 44, 178)], TEXT, 1), text(x + 48, 178, "second IMU, on the outer", 14)]
    parts += [
        text(x + 48, 196, "side of the upper arm: optional", 14),
        text(x + 22, 100, "shoulder in view", 14),
    ]
    parts += [text(camera_x - 70, 140, "camera, chest height", 14)]
    parts += [
        line([(camera_x, floor + 22), (x, floor + 22)], TEXT, 1.5),
        line([(camera_x, floor + 14), (camera_x, floor + 30)], TEXT, 1.5),
    ]
    parts += [
        line([(x, floor + 14), (x, floor + 30)], TEXT, 1.5),
        text(0.5 * (camera_x + x), floor + 42, "1.5 to 3 m", 14, 'text-anchor="middle"'),
    ]
    return drawn(800, 385, "Camera at chest height, 1.5 to 3 m away; the IMU on the back of the wrist", parts)


def front_arm(x: float, raised_deg: float, bent_deg: float) -> list[tuple[float, float]]:
    """Shoulder, elbow and wrist of an arm in the picture's plane, in pixels about a shoulder at (x, 95)."""
    upper, fore = np.radians(90.0 - raised_deg), np.radians(90.0 - raised_deg - bent_deg)
    elbow = (x + 58 * float(np.cos(upper)), 95 + 58 * float(np.sin(upper)))
    return [(x, 95.0), elbow, (elbow[0] + 52 * float(np.cos(fore)), elbow[1] + 52 * float(np.sin(fore)))]


def movements_drawing() -> str:
    """What to do for 20 s in view."""
    postures = {
        "bend and stretch the elbow": [(10, 0), (10, 50), (10, 100), (10, 140)],
        "raise the arm forwards and sideways": [(10, 5), (45, 5), (80, 5), (115, 5)],
    }
    parts = []
    for column, (words, angles) in enumerate(postures.items()):
        x = 110.0 + 250 * column
        parts += [
            f'<circle cx="{x - 14:g}" cy="52" r="19" fill="{SKIN}"/>',
            limb([(x - 14, 74), (x - 14, 180)], 30),
        ]
        for order, (raised_deg, bent_deg) in enumerate(angles):
            joints = front_arm(x, raised_deg, bent_deg)
            parts += [
                line(joints, SEEN, 7, f'stroke-opacity="{0.25 + 0.25 * order:g}"'),
                dots(joints[2:], RECOVERED, 5),
            ]
        parts.append(text(x + 5, 236, words, 14, 'text-anchor="middle"'))
    for order, (words, offset) in enumerate((("palm up", -7.0), ("palm down", 7.0))):
        y = 85.0 + 75 * order
        parts += [limb([(580, y), (680, y)], 17, SEEN), limb([(680, y), (722, y)], 12, SKIN)]
        parts += [
            line([(694, y + offset * 0.9), (722, y + offset * 0.9)], TEXT, 2),
            sensor(664, y - offset * 1.6, 0, RECOVERED),
        ]
        parts.append(text(594, y - 18, words, 13))
    parts.append(text(650, 236, "turn the forearm, three times", 14, 'text-anchor="middle"'))
    return drawn(800, 255, "Bend the elbow, raise the arm, turn the forearm: 20 s in view", parts)


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
