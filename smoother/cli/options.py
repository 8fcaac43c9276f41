"""Arguments and options that several commands share; an option of one command stands beside its parameter.

A path among them is read, unless its annotation says how it is written: the files of a command with `Out` are
checked before it begins.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ..errors import RecordingError, UnoccludeError

#: Of a path: it is written, replaced with --force alone; it is added to; it is read, and may be the one that
#: is added to; the command itself checks it.
WRITTEN, ADDED_TO, SHARED, UNCHECKED = "written", "added to", "shared", "unchecked"

ARM, SET_UP, ADVANCED = "Which arm", "Correct a wrong set-up", "Advanced"
#: What a command's help has, in this order.
PANELS = ("Arguments", "Options", ARM, SET_UP, ADVANCED)


def argument(metavar: str, help: str, **more: Any) -> Any:
    """An argument; it has no default that would be shown."""
    return typer.Argument(metavar=metavar, help=help, show_default=False, **more)


def option(help: str, *flags: str, panel: str | None = None, **more: Any) -> Any:
    """An option; without flags it is called as its parameter. A default None is not shown."""
    return typer.Option(*flags, help=help, rich_help_panel=panel, **more)


def value(metavar: str, help: str, *flags: str, **more: Any) -> Any:
    """An option whose value is called so in its help."""
    return option(help, *flags, metavar=metavar, **more)


rare, rare_value = partial(option, panel=ADVANCED), partial(value, panel=ADVANCED)
_arm, _set_up = partial(value, panel=ARM), partial(value, panel=SET_UP)

#: What may be left out.
File = Path | None
Files = list[Path] | None
Text = str | None
Texts = list[str] | None
Number = float | None
Count = int | None
SideName = Literal["left", "right"] | None
Axes = Literal["kinect", "optical", "zup"] | None
Filter = Literal["vqf", "madgwick", "comotti", "complementary"] | None
Limbs = Literal["adult", "child", "any"] | None


def refuse(wrong: Mapping[str, object]) -> None:
    """Refuse wrong use: the first sentence that holds."""
    for sentence, holds in wrong.items():
        if holds:
            raise typer.BadParameter(sentence)


def listed(text: str, known: Collection[str], what: str) -> list[str]:
    """The names of a comma-separated list, each once; "all" is every one that is known."""
    wanted = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in known]
    if wanted == ["all"]:
        return list(known)
    if unknown or not wanted:
        why = f"there is no {what} '{unknown[0]}'" if unknown else f"name a {what}"
        raise typer.BadParameter(f"{why}; {what}s: {', '.join(known)}")
    return list(dict.fromkeys(wanted))


#: Endings of what a report is not, of what `unocclude export` writes, and of what else is no recording.
_NO_PAGE = {".pdf", ".doc", ".docx", ".odt", ".png", ".json", ".csv", ".toml", ".txt", ".md"}
_EXPORTED = {".csv", ".trc", ".mot", ".c3d", ".parquet", ".sto"}
_NO_MCAP = _EXPORTED | {".html", ".json", ".toml", ".txt", ".mat", ".bag", ".rrd", ".osim", ".npz"}


def _page(path: Path | None) -> Path | None:
    """Refuse a report whose ending is not that of a page, before any work is done for it."""
    if path is not None and path.suffix.lower() in _NO_PAGE:
        name = path.with_suffix(".html")
        raise typer.BadParameter(f"a report is an HTML page; name it {name} (a browser prints it to PDF)")
    return path


def as_mcap(path: Path | None) -> Path | None:
    """Refuse to write MCAP to a file whose ending says something else."""
    if path is not None and path.suffix.lower() in _NO_MCAP:
        raise UnoccludeError(f"{path}: the output is MCAP; name it {path.with_suffix('.mcap')}")
    return path


def _as_result(path: Path) -> Path | None:
    """The same of a result, which can be exported."""
    if (ending := path.suffix.lower()) in _EXPORTED:
        mcap = path.with_suffix(".mcap")
        command = shlex.join(["unocclude", "export", str(mcap), "--format", ending[1:], "-o", str(path)])
        raise UnoccludeError(f"{path}: the result is MCAP; write it to {mcap}, then `{command}`")
    return as_mcap(path)


def _there(path: Path) -> Path:
    """Refuse a name that nothing has, before anything is loaded for it."""
    if not os.path.lexists(path):
        raise RecordingError(f"{path} does not exist; check the name.")
    return path


RecordingPath = Annotated[Path, argument("REC.mcap", "The recording.", callback=_there)]
Result = Annotated[Path, argument("OUT.mcap", "What `smooth` wrote.", callback=_there)]
_out = partial(value, "FILE", "Output file.", "-o", "--output")
Output = Annotated[Path, _out(callback=as_mcap), WRITTEN]
ResultOutput = Annotated[Path, _out(callback=_as_result), WRITTEN]
FolderOutput = Annotated[Path, value("FOLDER", "Where results go.", "-o", "--output"), UNCHECKED]
CalibrationOutput = Annotated[
    Path, value("CAL.toml", "File to write or to add to.", "-o", "--output"), ADDED_TO
]
Report = Annotated[File, value("OUT.html", "Also write a report, one HTML page.", callback=_page), WRITTEN]
Csv = Annotated[File, value("FILE", "Also write all values as a table.", "--csv"), WRITTEN]
Json = Annotated[File, value("FILE", "Also write the figures as JSON.", "--json"), WRITTEN]
Force = Annotated[bool, option("Overwrite outputs that exist.", "--force")]

Calibration = Annotated[
    File, value("CAL.toml", "IMU mounting, lever arms, limb lengths.", "--calibration"), SHARED
]
Session = Annotated[File, value("FOLDER", "Trials of the same strap, calibrated together (or a list).")]
Known = Annotated[File, value("CAL.toml", "Calibration file with values to use as given.", "--known"), SHARED]
Strict = Annotated[bool, option("Exit with 3 where a result is not to be trusted.", "--strict")]
Verbose = Annotated[bool, option("Print all estimates, gaps and notes.", "--verbose")]
Seed = Annotated[int, value("S", "Same seed, same result.", min=0)]
_how_set = "A setting, as imu_rate_hz=100; may be given again. `--set list` prints all."
Settings = Annotated[Texts, value("KEY=VALUE", _how_set, "--set")]
Draws = Annotated[Count, rare("Drawn motions; 0 = none.  [default: 64]", min=0, max=1000)]
Align = Annotated[bool, option("Align poses given as truth (other frame or clock).", "--align")]
Templates = Annotated[Files, value("FILE.toml", "A table layout of your own; tried first.", "--template")]
Depth = Annotated[Files, value("D.png", "Depth image, 16 bit, mm; one per panel pose.")]
Infrared = Annotated[Files, value("I.png", "Infrared image of the same moment.")]
_lens = "width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3]."
Intrinsics = Annotated[File, value("K.toml", _lens)]
_board = "[panel] markers = [[x, y], ..], extent = [[xmin, ymin], [xmax, ymax]], m."
Panel = Annotated[File, value("P.toml", _board)]

Imu = Annotated[Text, _arm("TOPIC", "The forearm IMU, where there are several.", "--imu")]
Skeleton = Annotated[Text, _arm("TOPIC", "The skeleton, where there are several.", "--skeleton")]
Side = Annotated[SideName, option("The arm that wears the IMU.", panel=ARM)]
Body = Annotated[Count, _arm("N", "The person, where the camera saw several.")]

Mirror = Annotated[Text, _set_up("x|y|z", "Undo a skeleton mirrored along this axis.")]
Swap = Annotated[Text, _set_up("A,B", "Swap two joints (elbow,wrist), or left,right.")]
Negate = Annotated[Text, _set_up("SENSOR,..", "Reverse accelerometer, gyroscope or both.")]
CameraAxes = Annotated[
    Axes, _set_up("AXES", "kinect, optical or zup, overriding the file.", "--camera-frame")
]
ClockOffset = Annotated[Number, _set_up("S", "IMU time minus camera time.  [default: estimated]")]
#: One standard deviation of a clock that was measured, where none is stated, s.
CLOCK_SIGMA_S = 0.02
_clock_sigma = f"Standard deviation of --clock-offset.  [default: {CLOCK_SIGMA_S:g}]"
ClockSigma = Annotated[Number, _set_up("S", _clock_sigma)]

ConfigFile = Annotated[File, rare_value("CONF.toml", "Settings, as `unocclude config` prints.", "--config")]
Processes = Annotated[Count, rare_value("N", "Worker processes; 0 = one per core.", min=0)]
_filters = "vqf (default), madgwick, comotti or complementary; not of graph."
Orientation = Annotated[Filter, rare_value("FILTER", _filters)]
Anatomy = Annotated[Limbs, rare("Range of limb lengths that is plausible.")]
BodyHeight = Annotated[Number, rare_value("M", "For limb lengths before a camera without depth.")]
