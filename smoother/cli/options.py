"""Arguments and options that several commands share; an option of one command stands beside its parameter."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

ARM, SET_UP, ADVANCED = "Which arm", "Correct a wrong set-up", "Advanced"
#: What a command's help has, in this order.
PANELS = ("Arguments", "Options", ARM, SET_UP, ADVANCED)


def argument(metavar: str, help: str) -> Any:
    """An argument; it has no default that would be shown."""
    return typer.Argument(metavar=metavar, help=help, show_default=False)


def option(help: str, *flags: str, panel: str | None = None, **more: Any) -> Any:
    """An option; without flags it is called as its parameter. A default None is not shown."""
    return typer.Option(*flags, help=help, rich_help_panel=panel, **more)


rare = partial(option, panel=ADVANCED)
_arm, _set_up = partial(option, panel=ARM), partial(option, panel=SET_UP)

RecordingPath = Annotated[Path, argument("REC.mcap", "The recording.")]
Result = Annotated[Path, argument("OUT.mcap", "What `smooth` wrote.")]
Output = Annotated[Path, option("Output file.", "-o", "--output", metavar="FILE")]
CalibrationOutput = Annotated[
    Path, option("File to write or to add to.", "-o", "--output", metavar="CAL.toml")
]
Calibration = Annotated[
    Path | None,
    option("Calibration: IMU mounting, lever arms, limb lengths.", "--calibration", metavar="CAL.toml"),
]
Known = Annotated[
    Path | None, option("Calibration file with values to use as given.", "--known", metavar="CAL.toml")
]
Json = Annotated[Path | None, option("Also write the figures as JSON.", "--json", metavar="FILE")]
Force = Annotated[bool, option("Overwrite outputs that exist.", "--force")]
Strict = Annotated[
    bool, option("Exit with 3 where a result is not to be trusted; outputs are written.", "--strict")
]
Verbose = Annotated[bool, option("Print all estimates, gaps and notes.", "--verbose")]
Seed = Annotated[int, option("Same seed, same result.", metavar="S", min=0)]
Settings = Annotated[
    list[str] | None,
    option(
        "A setting, as imu_rate_hz=100; may be given again. `--set list` prints all.",
        "--set",
        metavar="KEY=VALUE",
    ),
]

Imu = Annotated[str | None, _arm("The forearm IMU, where there are several.", "--imu", metavar="TOPIC")]
Skeleton = Annotated[
    str | None, _arm("The skeleton, where there are several.", "--skeleton", metavar="TOPIC")
]
Side = Annotated[Literal["left", "right"] | None, _arm("The arm that wears the IMU.")]
Body = Annotated[int | None, _arm("The person, where the camera saw several.", metavar="N")]

Mirror = Annotated[str | None, _set_up("Undo a skeleton mirrored along this axis.", metavar="x|y|z")]
Swap = Annotated[str | None, _set_up("Swap two joints (elbow,wrist), or left,right.", metavar="A,B")]
Negate = Annotated[
    str | None, _set_up("Reverse the sign of accelerometer, gyroscope or both.", metavar="SENSOR,..")
]
CameraAxes = Annotated[
    Literal["kinect", "optical", "zup"] | None,
    _set_up("The camera's axes, overriding the file's.", "--camera-frame"),
]
ClockOffset = Annotated[
    float | None, _set_up("Measured IMU time minus camera time.  [default: estimated]", metavar="S")
]
#: One standard deviation of a clock that was measured, where none is stated, s.
CLOCK_SIGMA_S = 0.02
ClockSigma = Annotated[
    float | None,
    _set_up(f"Standard deviation of --clock-offset.  [default: {CLOCK_SIGMA_S:g}]", metavar="S"),
]

ConfigFile = Annotated[
    Path | None,
    rare("Settings; `unocclude config` prints the defaults.", "--config", metavar="CONF.toml"),
]
Processes = Annotated[int | None, rare("Worker processes; 0 = one per core.", metavar="N", min=0)]
Orientation = Annotated[
    Literal["vqf", "madgwick", "comotti", "complementary"] | None,
    rare("Orientation filter of the methods other than graph.  [default: vqf]"),
]
Anatomy = Annotated[Literal["adult", "child", "any"] | None, rare("Range of limb lengths that is plausible.")]
BodyHeight = Annotated[
    float | None, rare("The person's, for limb lengths before one camera without depth.", metavar="M")
]
Live = Annotated[bool, rare("Also replay it through the live smoother and two simple methods.", "--live")]
Latency = Annotated[float, rare("Latency of the camera for --live, s.", metavar="S", min=0.0, max=1.0)]

Align = Annotated[bool, option("Align poses given as truth (other frame or clock).", "--align")]
Templates = Annotated[
    list[Path] | None,
    option("Template of a table layout of your own; tried first.", "--template", metavar="FILE.toml"),
]
Files = list[Path] | None
Depth = Annotated[Files, option("Depth image, 16 bit, mm; one per panel pose.", metavar="D.png")]
Infrared = Annotated[Files, option("Infrared image of the same moment.", metavar="I.png")]
Intrinsics = Annotated[
    Path | None,
    option("width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3].", metavar="K.toml"),
]
Panel = Annotated[
    Path | None,
    option("[panel] markers = [[x, y], ..], extent = [[xmin, ymin], [xmax, ymax]], m.", metavar="P.toml"),
]

#: Endings of what a report is not.
_NO_PAGE = {".pdf", ".doc", ".docx", ".odt", ".png", ".json", ".csv", ".toml", ".txt", ".md"}


def _page(path: Path | None) -> Path | None:
    """Refuse a report whose ending is not that of a page, before any work is done for it."""
    if path is not None and path.suffix.lower() in _NO_PAGE:
        name = path.with_suffix(".html")
        raise typer.BadParameter(f"a report is an HTML page; name it {name} (a browser prints it to PDF)")
    return path


Report = Annotated[
    Path | None, option("Also write a report, one HTML page.", metavar="OUT.html", callback=_page)
]
