"""`unocclude demo`, `app`, `doctor`, `config`: the main job on a small recording or on a page; settings."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from ..runtime.packages import OPEN3D, extra_module
from ..table import tabulated
from . import options as o
from .output import check_outputs, progress_bar, say, say_command, show, write_json

#: Used where `data/` has no recording.
SEED = 1


def demo(
    folder: Annotated[
        Path,
        o.value("FOLDER", "Replaces an earlier one.", "-o", "--output"),
    ] = Path("out/demo"),
    processes: o.Processes = None,
    json_file: o.Json = None,
) -> None:
    """Recover a small recording, validate it, write a report.

    Example: unocclude demo
    """
    from .. import smooth
    from ..error_radius import in_cm, within_words
    from ..evaluation.validate import validate
    from ..io import read_recording, write_recovery
    from ..report import write_report
    from .config import read_config, with_processes
    from .methods import usual_draws
    from .smooth import print_recovery, smooth_figures

    folder.mkdir(parents=True, exist_ok=True)
    check_outputs(True, [json_file])
    source = _recording(folder)
    recording = read_recording(source)
    say(f"recording: {source}")
    with progress_bar("recovering") as progress:
        config = with_processes(read_config(None), processes)
        recovery = smooth(recording, None, config, progress, draws=usual_draws(None))
    result, report = folder / "demo_recovered.mcap", folder / "demo_report.html"
    write_recovery([recovery], result, source=source, force=True)
    truth = recording.truth
    with progress_bar("measuring") as progress:
        validation = None
        if truth is not None:
            worker_count = config.windows.processes
            validation = validate(recovery, truth, processes=worker_count, progress=progress)
    write_report(recovery, report, recording=recording, validation=validation, truth=truth, force=True)
    figures = {
        "recovery": smooth_figures(recording, recovery),
        "validation": validation and validation.to_dict(),
        "report": report.name,
    }
    write_json(json_file, figures, True)
    print_recovery(recording, recovery)
    if validation is not None and validation.occluded.position_p95_m is not None:
        within, most_m = within_words(validation.occluded.position_p95_m), validation.occluded.position_max_m
        say(f"In the gaps the answer is {within} of the truth, {in_cm(most_m or 0.0)} at most.")
    say("Joints, joint angles and the calibration are in the report.")
    by_hand = folder / "by_hand.mcap"
    say("Without any calibration, as a first recording of your own. The same by hand:")
    say_command("smooth", source, "-o", by_hand, "--force")
    if validation is not None:
        say_command("validate", by_hand, "--truth", source)
    say(f"result: {result}")
    say(f"report: {report.resolve()}")


def _recording(folder: Path) -> Path:
    """The recording beside the source tree, or one simulated on the spot."""
    kept = Path(__file__).parents[2] / "data" / "demo.mcap"
    if kept.is_file():
        return kept
    from ..io import write_recording
    from ..simulation import ArmSimulation, simulate_arm

    path = folder / "demo.mcap"
    write_recording(simulate_arm(ArmSimulation.preset("realistic"), SEED).recording, path, force=True)
    return path


PACKAGES = (
    *("unocclude", "gtsam", "numpy", "scipy", "vqf", "mcap", "protobuf", "foxglove-schemas-protobuf"),
    *("pydantic", "typer", "rich", "plotly", "opencv-python-headless", OPEN3D),
)


def doctor(json_file: o.Json = None, force: o.Force = False) -> None:
    """Check the installation.

    Example: unocclude doctor
    """
    from importlib import metadata  # slow to load, and every command loads this file

    check_outputs(force, [json_file])
    parts: dict[str, Callable[[], str]] = {
        "python": lambda: f"{platform.python_version()} on {platform.platform()}",
        **{name: partial(metadata.version, name) for name in PACKAGES},
        "solver": solve_something,
        "point clouds": use_open3d,
        "cores": lambda: str(os.cpu_count() or 1),
        "memory": memory,
    }
    figures: dict[str, dict[str, object]] = {}
    for name, use in parts.items():
        try:
            figures[name] = {"ok": True, "found": use()}
        except metadata.PackageNotFoundError:
            figures[name] = {"ok": False, "found": "not installed"}
        except Exception as error:  # a broken native library raises anything
            found = " ".join(f"{type(error).__name__}: {error}".split())
            figures[name] = {"ok": False, "found": found}
    write_json(json_file, figures, force)
    rows = [{"part": name, **found} for name, found in figures.items()]
    show(tabulated("Installation", rows, "part ok found"))
    if bad := [name for name, found in figures.items() if not found["ok"]]:
        print(f"unocclude: not usable: {', '.join(bad)}; run `make setup`, or install again", file=sys.stderr)
        raise typer.Exit(1)


def solve_something() -> str:
    """Fuse two measurements of a point with GTSAM."""
    import gtsam
    import numpy as np

    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for measured in (0.0, 2.0):
        noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
        graph.add(gtsam.PriorFactorPoint3(1, np.array([measured, 0.0, 0.0]), noise))
    start.insert(1, np.array([5.0, 5.0, 5.0]))
    answer = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize().atPoint3(1)
    if not np.allclose(answer, [1.0, 0.0, 0.0], atol=1e-6):
        raise ArithmeticError(f"gtsam answers {answer} where (1, 0, 0) is right")
    return "gtsam solves a small problem"


def use_open3d() -> str:
    """Import Open3D and cast a ray."""
    from ..runtime.packages import load_open3d

    open3d = load_open3d()
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(open3d.geometry.TriangleMesh.create_box()))
    ray = open3d.core.Tensor([[0.5, 0.5, -1.0, 0.0, 0.0, 1.0]], open3d.core.Dtype.Float32)
    distance = float(scene.cast_rays(ray)["t_hit"].numpy()[0])
    if abs(distance - 1.0) > 1e-4:
        raise ArithmeticError(f"a ray hits at {distance} m where 1 m is right")
    return "open3d casts a ray"


def memory() -> str:
    """Memory of this computer, if the system reports it."""
    try:
        return f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.1f} GiB"
    except (AttributeError, ValueError, OSError):
        return "not known on this system"


def config(config_file: o.ConfigFile = None, json_file: o.Json = None, force: o.Force = False) -> None:
    """Print the configuration as TOML.

    Example: unocclude config > settings.toml
    """
    from .config import read_config, to_toml

    check_outputs(force, [json_file], [config_file])
    settings = read_config(config_file)
    say(to_toml(settings).rstrip("\n"))
    write_json(json_file, settings.model_dump(mode="json"), force)


#: Where recordings are stored unless the user says otherwise.
FOLDER = Path("unocclude")


def app(
    port: Annotated[
        int | None, o.rare_value("N", "Of the page.  [default: a free one]", min=0, max=65535)
    ] = None,
    folder: Annotated[o.File, o.value("DIR", "Of recordings.  [default: ~/unocclude]")] = None,
    no_browser: Annotated[bool, o.option("Print the address only.", "--no-browser")] = False,
) -> None:
    """Open the local page: from files to report in the browser.

    The printed address contains a token, which is required. Other computers cannot open the page.
    Ctrl-C ends it: what is running then is stopped and can be repeated, all else is kept in the folder.

    Example: unocclude app --folder recordings
    """
    for name, package in (("uvicorn", "uvicorn"), ("starlette", "starlette")):
        extra_module(name, package, "app")
    from ..app.folder import AppFolder
    from ..app.serving import redirect_file, serve

    place = AppFolder(Path.home() / FOLDER if folder is None else folder)

    def ready(address: str) -> None:
        print(address, flush=True)
        if not no_browser:
            import webbrowser

            webbrowser.open(redirect_file(place, address).as_uri())

    serve(place, port, ready)
