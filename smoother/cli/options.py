"""Arguments and options that several commands share, one by one and in groups."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import typer

from ..baselines.registry import DEFAULT_ORIENTATION, ORIENTATIONS

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo


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


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of its groups, in the groups' places.

    Parameters
    ----------
    command : callable
        Parameters whose type is a dataclass stand for its fields, which are annotated as options.

    Returns
    -------
    command : callable
        For typer, under the same name.
    """
    own = inspect.signature(command, eval_str=True).parameters
    kinds = {name: each.annotation for name, each in own.items() if isinstance(each.annotation, type)}
    groups = {name: kind for name, kind in kinds.items() if is_dataclass(kind)}

    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{each.name: values.pop(each.name) for each in fields(group)})
        command(**values)

    parameters: list[inspect.Parameter] = []
    for name, parameter in own.items():
        parameters += _options(groups[name]) if name in groups else [parameter]
    return with_signature(run, command, parameters)


def with_signature(
    run: Callable[..., None], command: Callable[..., None], parameters: list[inspect.Parameter]
) -> Callable[..., None]:
    """`run` under the command's name and help, with these parameters, as typer reads them."""
    # keyword-only throughout: options have no order
    parameters = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in parameters]
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def _options(group: type[Any]) -> list[inspect.Parameter]:
    kinds = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            each.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if each.default is MISSING else each.default,
            annotation=kinds[each.name],
        )
        for each in fields(group)
    ]


def with_settings(command: Any, settings: dict[str, FieldInfo]) -> Any:
    """The command with an option for every setting of a simulation."""
    own = [p for p in inspect.signature(command, eval_str=True).parameters.values() if p.name != "settings"]
    taken = {parameter.name for parameter in own}
    fields = {name: field for name, field in settings.items() if name not in taken}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_option(name, field))
        for name, field in fields.items()
    ]

    def run(**values: Any) -> None:
        command(**values)

    return with_signature(run, command, own + more)


def _option(name: str, field: FieldInfo) -> Any:
    """The option of a setting; None where it is not given."""
    flag = "--" + name.replace("_", "-")
    default = field.get_default()
    text = _shown(default)
    about = ". ".join(part for part in (field.description, f"[{text}]") if part)
    if isinstance(default, bool):
        return Annotated[bool | None, typer.Option(f"{flag}/--no-{flag[2:]}", help=about, show_default=False)]
    kind: Any = str
    if isinstance(default, int):
        kind = int
    elif isinstance(default, float) or (default is None and float in get_args(field.annotation)):
        kind = float
    metavar = "|".join(_choices(field)) or {int: "N", float: "X", str: "X,X,.."}[kind]
    return Annotated[kind | None, typer.Option(flag, metavar=metavar, help=about, show_default=False)]


def _choices(field: FieldInfo) -> list[str]:
    """Values that a setting may take, where they are named."""
    if hasattr(field.annotation, "__members__"):
        return [str(member.value) for member in field.annotation]  # type: ignore[union-attr]
    return [value for value in get_args(field.annotation) if isinstance(value, str)]


def _shown(default: Any) -> str:
    if default is None:
        return "none"
    if isinstance(default, tuple):
        return ",".join(str(item) for item in default)
    return str(default.value if hasattr(default, "value") else default).lower()
