"""`unocclude doctor`: is everything here that the work needs."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable

import typer

from .options import Force, Json
from .output import check_outputs, print_table, write_json

PACKAGES = (
    "unocclude",
    "gtsam",
    "numpy",
    "scipy",
    "vqf",
    "mcap",
    "protobuf",
    "foxglove-schemas-protobuf",
    "pydantic",
    "typer",
    "rich",
    "plotly",
    "opencv-python-headless",
)
OPEN3D = "open3d-cpu" if sys.platform == "linux" and platform.machine() == "x86_64" else "open3d"


def doctor(json_file: Json = None, force: Force = False) -> None:
    """Check the installation: versions, the solver, point clouds, cores and memory."""
    check_outputs(force, [json_file])
    checks = [("python", True, f"{platform.python_version()} on {platform.platform()}")]
    checks += [check_version(name) for name in (*PACKAGES, OPEN3D)]
    checks.append(check("solver", solve_something))
    checks.append(check("point clouds", use_open3d))
    checks.append(("cores", True, str(os.cpu_count() or 1)))
    checks.append(("memory", True, memory()))
    figures = {name: {"ok": good, "found": text} for name, good, text in checks}
    write_json(json_file, figures, force)
    print_table("Installation", ("part", "ok", "found"), [(n, "yes" if g else "NO", t) for n, g, t in checks])
    bad = [name for name, good, _ in checks if not good]
    if bad:
        print(f"unocclude: not usable: {', '.join(bad)}; run `make setup`, or install again", file=sys.stderr)
        raise typer.Exit(1)


def check_version(package: str) -> tuple[str, bool, str]:
    """A package's version, and whether it is there."""
    from importlib import metadata  # slow to load, and every command loads this file

    try:
        return package, True, metadata.version(package)
    except metadata.PackageNotFoundError:
        return package, False, "not installed"


def check(name: str, use: Callable[[], str]) -> tuple[str, bool, str]:
    """Use a part; whatever it raises is what was found."""
    try:
        return name, True, use()
    except Exception as error:  # a broken native library raises anything
        return name, False, " ".join(f"{type(error).__name__}: {error}".split())


def solve_something() -> str:
    """Fuse two measurements of a point with GTSAM."""
    import gtsam
    import numpy as np

    graph = gtsam.NonlinearFactorGraph()
    for measured in (0.0, 2.0):
        noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
        graph.add(gtsam.PriorFactorPoint3(1, np.array([measured, 0.0, 0.0]), noise))
    start = gtsam.Values()
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
    """Memory of this computer, where the system tells."""
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return "not known on this system"
    return f"{total / 2**30:.1f} GiB"
