"""The configuration as a TOML file: read, and printed with its units. `unocclude config` and `doctor`."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from ..errors import UnoccludeError
from ..runtime.packages import OPEN3D
from ..table import tabulated
from . import options as o
from .output import Out, say, show

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    from ..config import Config

    Settings = TypeVar("Settings", bound=BaseModel)


def read_config(
    config_file: Path | None,
    processes: int | None = None,
    anatomy: str | None = None,
    body_height: float | None = None,
) -> Config:
    """Read a configuration; what neither it nor the options name keeps its default."""
    from pydantic import ValidationError

    from ..config import Config

    config = with_processes(read_settings(config_file, Config), processes)
    given = {"anatomy": anatomy, "height_m": body_height}
    arm = config.arm.model_dump() | {name: value for name, value in given.items() if value is not None}
    try:
        return config.model_copy(update={"arm": type(config.arm).model_validate(arm)})
    except ValidationError as error:
        raise typer.BadParameter(f"--body-height is in m, as 1.75; not {body_height:g}") from error


def read_settings(path: Path | None, kind: type[Settings]) -> Settings:
    """Read settings of any kind; what the file does not name keeps its default."""
    from pydantic import ValidationError

    from ..runtime.inputs import check_input, read_toml

    if path is None:
        return kind()
    check_input(path)
    try:
        return kind.model_validate(read_toml(path))
    except ValidationError as error:
        raise UnoccludeError(f"{path}: {describe(error)}") from error
    except OSError as error:
        raise UnoccludeError(f"{path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # also a number of thousands of digits
        raise UnoccludeError(f"{path}: not a TOML file: {error}") from error


def describe(error: ValidationError) -> str:
    """The first thing that a check found, with the key that it concerns."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if first["type"] == "extra_forbidden":
        return f"there is no setting '{key}'{more}"
    return f"'{key}' = {first['input']!r}: {first['msg'][:1].lower()}{first['msg'][1:]}{more}"


def with_processes(config: Config, processes: int | None) -> Config:
    """The configuration with another number of worker processes, if one is given."""
    if processes is None:
        return config
    windows = config.windows.model_copy(update={"processes": processes})
    return config.model_copy(update={"windows": windows})


def to_toml(config: BaseModel) -> str:
    """The configuration as TOML; each setting's meaning and unit in a comment."""
    lines: list[str] = []
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if hasattr(value, "model_fields"):
            summary = (type(value).__doc__ or "").strip().splitlines()
            lines += [*([""] if lines else []), *(f"# {each}" for each in summary[:1]), f"[{name}]"]
            lines.append(to_toml(value).rstrip("\n"))
            continue
        comment = f"  # {field.description}" if field.description else ""
        # strings, numbers, flags and lists are written as JSON writes them
        known = f"{name} = {json.dumps(value, ensure_ascii=False)}"
        lines.append((f"# {name} =" if value is None else known) + comment)
    return "\n".join(lines) + "\n"


def config(out: Out, config_file: o.ConfigFile = None) -> None:
    """Print the configuration as TOML.

    Example: unocclude config > settings.toml
    """
    settings = read_config(config_file)
    out.json(settings.model_dump(mode="json"))
    say(to_toml(settings).rstrip("\n"))


PACKAGES = (
    *("unocclude", "gtsam", "numpy", "scipy", "vqf", "mcap", "protobuf", "foxglove-schemas-protobuf"),
    *("pydantic", "typer", "rich", "plotly", "opencv-python-headless", OPEN3D),
)


def doctor(out: Out) -> None:
    """Check the installation.

    Example: unocclude doctor
    """
    from importlib import metadata  # slow to load, and every command loads this file

    parts: dict[str, Callable[[], str]] = {
        "python": lambda: f"{platform.python_version()} on {platform.platform()}",
        **{name: partial(metadata.version, name) for name in PACKAGES},
        "solver": solve_something,
        "point clouds": use_open3d,
        "cores": lambda: str(os.cpu_count() or 1),
    }
    figures: dict[str, dict[str, object]] = {}
    for name, use in parts.items():
        try:
            figures[name] = {"ok": True, "found": use()}
        except metadata.PackageNotFoundError:
            figures[name] = {"ok": False, "found": "not installed"}
        except Exception as error:  # a broken native library raises anything
            figures[name] = {"ok": False, "found": " ".join(f"{type(error).__name__}: {error}".split())}
    out.json(figures)
    rows = [{"part": name, **found} for name, found in figures.items()]
    show(tabulated("Installation", rows, "part ok found"))
    if bad := [name for name, found in figures.items() if not found["ok"]]:
        print(f"unocclude: not usable: {', '.join(bad)}; run `make setup`, or install again", file=sys.stderr)
        raise typer.Exit(1)


def solve_something() -> str:
    """Fuse two measurements of a point with GTSAM."""
    import gtsam

    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for measured in (0.0, 2.0):
        noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
        graph.add(gtsam.PriorFactorPoint3(1, gtsam.Point3(measured, 0.0, 0.0), noise))
    start.insert(1, gtsam.Point3(5.0, 5.0, 5.0))
    answer = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize().atPoint3(1)
    if max(abs(answer - gtsam.Point3(1.0, 0.0, 0.0))) > 1e-6:
        raise ArithmeticError(f"gtsam answers {answer} where (1, 0, 0) is right")
    return "gtsam solves a small problem"


def use_open3d() -> str:
    """Import Open3D and cast a ray."""
    from ..runtime.packages import load_open3d

    open3d = load_open3d()
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.t.geometry.TriangleMesh.create_box())
    ray = open3d.core.Tensor([[0.5, 0.5, -1.0, 0.0, 0.0, 1.0]], open3d.core.Dtype.Float32)
    distance = float(scene.cast_rays(ray)["t_hit"].numpy()[0])
    if abs(distance - 1.0) > 1e-4:
        raise ArithmeticError(f"a ray hits at {distance} m where 1 m is right")
    return "open3d casts a ray"
