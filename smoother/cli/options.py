"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..baselines.registry import DEFAULT_ORIENTATION, ORIENTATIONS

RecordingPath = Annotated[Path, typer.Argument(metavar="REC.mcap", help="The recording.", show_default=False)]
Output = Annotated[
    Path, typer.Option("-o", "--output", metavar="FILE", help="What to write.", show_default=False)
]
CalibrationOutput = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="CAL.toml", help="File to write or to add to.", show_default=False
    ),
]
Calibration = Annotated[
    Path | None,
    typer.Option(
        "--calibration", metavar="CAL.toml", help="How the IMU sits on the arm, and the arm's measures."
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="CONF.toml", help="Settings; `unocclude config` prints the defaults."),
]
Imu = Annotated[
    str | None,
    typer.Option("--imu", metavar="TOPIC", help="The forearm IMU, where the recording has several."),
]
Skeleton = Annotated[
    str | None,
    typer.Option("--skeleton", metavar="TOPIC", help="The skeleton, where the recording has several."),
]
Side = Annotated[str | None, typer.Option("--side", metavar="left|right", help="The arm that wears the IMU.")]
Body = Annotated[
    int | None, typer.Option("--body", metavar="N", help="The person, where the camera saw several.")
]
#: Endings of what a report is not.
_NO_PAGE = {".pdf", ".doc", ".docx", ".odt", ".png", ".json", ".csv", ".toml", ".txt", ".md"}


def _page(path: Path | None) -> Path | None:
    """Refuse a report whose ending says that it is no page, before any work is done for it."""
    if path is not None and path.suffix.lower() in _NO_PAGE:
        name = path.with_suffix(".html")
        raise typer.BadParameter(f"a report is an HTML page; name it {name} (a browser prints it to PDF)")
    return path


Report = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="OUT.html",
        help="Also write a report, one page that opens anywhere.",
        callback=_page,
    ),
]
Processes = Annotated[
    int | None, typer.Option("--processes", metavar="N", min=0, help="Worker processes; 0 = one a core.")
]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Also write the figures as JSON.")]
Strict = Annotated[
    bool,
    typer.Option(
        "--strict", help="Exit with 3 where a result is not to be trusted; outputs are written all the same."
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite outputs that exist.")]
Seed = Annotated[int, typer.Option("--seed", metavar="S", min=0, help="Same seed, same result.")]
Draws = Annotated[
    int,
    typer.Option(
        "--draws",
        metavar="N",
        min=0,
        max=1000,
        help="Also draw so many whole motions from the posterior, for intervals of what is measured on them.",
    ),
]
DrawSeed = Annotated[
    int | None,
    typer.Option("--seed", metavar="S", min=0, help="For --draws: same seed, same motions; 0."),
]
Orientation = Annotated[
    str | None,
    typer.Option(
        "--orientation",
        metavar="|".join(ORIENTATIONS),
        help=f"The orientation filter of the methods beside the graph; {DEFAULT_ORIENTATION} unless named.",
    ),
]
Files = list[Path] | None
Depth = Annotated[
    Files, typer.Option("--depth", metavar="D.png", help="Depth image, 16 bit, mm; one a panel pose.")
]
Infrared = Annotated[
    Files, typer.Option("--infrared", metavar="I.png", help="Infrared image of the same moment.")
]
IntrinsicsFile = Annotated[
    Path | None,
    typer.Option(
        "--intrinsics",
        metavar="K.toml",
        help="width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3].",
    ),
]
PanelFile = Annotated[
    Path | None,
    typer.Option(
        "--panel",
        metavar="PANEL.toml",
        help="[panel] markers = [[x, y], ..] and extent = [[xmin, ymin], [xmax, ymax]], m.",
    ),
]
BoundaryS = Annotated[
    float | None,
    typer.Option(
        "--boundary-s",
        metavar="S",
        help="For linear-drift: visible time on both sides of a gap that its ends are fitted through; 0.5 s.",
    ),
]
SolveLeverArms = Annotated[
    bool,
    typer.Option(
        "--solve-lever-arms",
        help="Also find how far the tracked strap lies from the IMU; without this it is the IMU's place.",
    ),
]


Anatomy = Annotated[
    str | None,
    typer.Option("--anatomy", metavar="adult|child|any", help="Whose arm; other lengths are not trusted."),
]
Result = Annotated[Path, typer.Argument(metavar="OUT.mcap", help="What `smooth` wrote.", show_default=False)]
Align = Annotated[
    bool, typer.Option("--align", help="Align a truth of poses too (another frame, another clock).")
]
PassthroughImages = Annotated[
    bool, typer.Option("--passthrough-images", help="Carry images and depth over (they show the person).")
]


def one_side(side: str | None) -> str | None:
    """Check `--side` before any work is done for it."""
    if side not in (None, "left", "right"):
        raise typer.BadParameter(f"--side is left or right, not '{side}'")
    return side


Live = Annotated[
    bool,
    typer.Option(
        "--live",
        help="Also play the recording into the live smoother, and into what could be shown without it.",
    ),
]
LatencyS = Annotated[
    float,
    typer.Option("--latency", metavar="S", min=0.0, max=1.0, help="Of the camera, for --live, s."),
]
