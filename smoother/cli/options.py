"""Arguments and options that several commands share, one by one and in groups."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import typer

from ..baselines.registry import DEFAULT_ORIENTATION, ORIENTATIONS

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from ..io.recording.choose import Selection


RecordingPath = Annotated[Path, typer.Argument(metavar="REC.mcap", help="The recording.", show_default=False)]
Output = Annotated[
    Path, typer.Option("-o", "--output", metavar="FILE", help="Output file.", show_default=False)
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
        "--calibration", metavar="CAL.toml", help="Calibration file: IMU mounting, lever arms, limb lengths."
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
    """Refuse a report whose ending is not that of a page, before any work is done for it."""
    if path is not None and path.suffix.lower() in _NO_PAGE:
        name = path.with_suffix(".html")
        raise typer.BadParameter(f"a report is an HTML page; name it {name} (a browser prints it to PDF)")
    return path


Report = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="OUT.html",
        help="Also write a report, one HTML page.",
        callback=_page,
    ),
]
Processes = Annotated[
    int | None, typer.Option("--processes", metavar="N", min=0, help="Worker processes; 0 = one per core.")
]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Also write the figures as JSON.")]
Strict = Annotated[
    bool,
    typer.Option(
        "--strict", help="Exit with 3 where a result is not to be trusted; outputs are written anyway."
    ),
]
Verbose = Annotated[bool, typer.Option("--verbose", help="Print all estimates, gaps and notes.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite outputs that exist.")]
Seed = Annotated[int, typer.Option("--seed", metavar="S", min=0, help="Same seed, same result.")]
Draws = Annotated[
    int | None,
    typer.Option(
        "--draws",
        metavar="N",
        min=0,
        max=1000,
        help="Motions drawn from the posterior, for intervals of measures; 0 = none.  [default: 64]",
    ),
]
DrawSeed = Annotated[
    int | None,
    typer.Option("--seed", metavar="S", min=0, help="Seed of the drawn motions.  [default: 0]"),
]
Orientation = Annotated[
    str | None,
    typer.Option(
        "--orientation",
        metavar="|".join(ORIENTATIONS),
        help=f"Orientation filter of the methods other than graph.  [default: {DEFAULT_ORIENTATION}]",
    ),
]
Files = list[Path] | None
Depth = Annotated[
    Files, typer.Option("--depth", metavar="D.png", help="Depth image, 16 bit, mm; one per panel pose.")
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
Lenses = Annotated[
    Path | None,
    typer.Option(
        "--intrinsics",
        metavar="FILE",
        help="Lenses, and places, of cameras whose files contain keypoints in images: OpenCV or ROS (YAML,"
        " JSON), Kalibr's camchain, Pose2Sim's Calib.toml; its names are the NAMEs of --skeleton.",
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
        help="For linear-drift: visible time on both sides of a gap used to fit its ends.  [default: 0.5]",
    ),
]
SolveLeverArms = Annotated[
    bool,
    typer.Option(
        "--solve-lever-arms",
        help="Also estimate the offset between tracked strap and IMU; without this it is zero.",
    ),
]


Anatomy = Annotated[
    str | None,
    typer.Option("--anatomy", metavar="adult|child|any", help="Range of limb lengths that is plausible."),
]
BodyHeight = Annotated[
    float | None,
    typer.Option(
        "--body-height",
        metavar="M",
        help="Of the person: how long the limbs are, where one camera without depth films them.",
    ),
]
Result = Annotated[Path, typer.Argument(metavar="OUT.mcap", help="What `smooth` wrote.", show_default=False)]
Align = Annotated[
    bool, typer.Option("--align", help="Also align poses given as truth (different frame or clock).")
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
        help="Also replay the recording through the live smoother and two simple methods.",
    ),
]
LatencyS = Annotated[
    float,
    typer.Option("--latency", metavar="S", min=0.0, max=1.0, help="Latency of the camera for --live, s."),
]


@dataclass(frozen=True)
class ArmSelection:
    """Which arm of a recording, as a group of a command's options."""

    imu: Imu = None  # Topics
    skeleton: Skeleton = None  # Topics
    side: Side = None  # "left" or "right"
    body: Body = None  # The person

    def reading(self) -> Selection:
        """As keywords for what reads a recording; checks `--side`."""
        return {
            "imu": self.imu,
            "skeleton": self.skeleton,
            "side": one_side(self.side),
            "body": self.body,
        }


#: What the recording itself shows.
ANY_ARM = ArmSelection()


@dataclass(frozen=True)
class Outputs:
    """What is written besides, as a group of a command's options."""

    report: Report = None
    json_file: Json = None
    force: Force = False  # Overwrite what exists


#: Nothing besides.
NO_FILES = Outputs()


#: Settings of simulations that have an option of their own; `--set` takes all.
DAILY = (
    *("protocol", "repetitions", "duration_s", "side", "imus", "cameras", "rgb"),
    *("poses", "tilt_deg", "camera_tilt_deg", "people", "sensors"),
)
_SET = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Any setting, as --set imu_rate_hz=100; may be given again. `--set list` prints all.",
    ),
]


def parsed_settings(given: Iterable[str], settings: Mapping[str, FieldInfo]) -> dict[str, str]:
    """What `--set KEY=VALUE` sets, by name; `list` prints the settings and ends."""
    found = {}
    for text in given:
        if text == "list":
            from .output import print_table

            rows = [
                (name, _shown(field.get_default()), field.description) for name, field in settings.items()
            ]
            print_table("Settings", ("key", "default", "what it is"), rows)
            raise typer.Exit
        key, mark, value = text.partition("=")
        name = key.strip().replace("-", "_")
        if not mark or name not in settings:
            why = f"there is no setting '{key.strip()}'" if mark else f"'{text}' is not KEY=VALUE"
            raise typer.BadParameter(f"--set: {why}; `--set list` prints all")
        found[name] = value.strip()
    return found


def with_groups(
    command: Callable[..., None], settings: Mapping[str, FieldInfo] | None = None
) -> Callable[..., None]:
    """The command with the options of its groups in the groups' places, and `--set` for its settings."""
    signature = inspect.signature(command, eval_str=True)
    own = [each for each in signature.parameters.values() if each.kind is not inspect.Parameter.VAR_KEYWORD]
    options = [option for each in own for option in _options(each)]
    taken = {option.name for option in options}
    options += [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_option(name, field))
        for name, field in (settings or {}).items()
        if name in DAILY and name not in taken
    ]
    if settings is not None:
        options.append(
            inspect.Parameter("set_", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_SET)
        )

    def run(**values: Any) -> None:
        if settings is not None:
            given = parsed_settings(values.pop("set_") or (), settings)
            values |= {name: None for name in settings if name not in values and name not in taken} | given
        mine = {each.name: _taken(each.name, each.annotation, values) for each in own}
        command(**mine, **values)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    # keyword-only throughout: options have no order
    options = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in options]
    run.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in options}
    return run


def _options(parameter: inspect.Parameter) -> list[inspect.Parameter]:
    """The parameter itself, or those of its group."""
    group = parameter.annotation
    if not is_dataclass(group):
        return [parameter]
    kinds = get_type_hints(group, include_extras=True)
    return [
        option
        for each in fields(group)
        for option in _options(
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if each.default is MISSING else each.default,
                annotation=kinds[each.name],
            )
        )
    ]


def _taken(name: str, kind: Any, values: dict[str, Any]) -> Any:
    """The value of an option, or the group made of its options' values; they are taken out."""
    if not is_dataclass(kind):
        return values.pop(name)
    kinds = get_type_hints(kind, include_extras=True)
    return kind(**{each.name: _taken(each.name, kinds[each.name], values) for each in fields(kind)})  # type: ignore[operator]


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
