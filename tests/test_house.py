"""The house: imports point down, heavy packages wait until they are needed, one word means one thing."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: The core from the bottom up; each floor may import those below it and itself.
STACK = (
    ("errors",),
    (
        "recording",
        "array_types",
        "body",
        "calibration",
        "config",
        "error_radius",
        "filters",
        "linalg",
        "rotation",
        "sketch",
        "splines",
        "units",
    ),
    ("runtime",),
    ("measurements",),
    ("cameras",),
    ("result", "angles", "joint_angles", "shoulder_angles", "matching"),
    ("window",),
    ("graph",),
    ("selfcal",),
    ("recovery",),
    ("smoothing",),
    ("several_arms",),
    ("live",),
)
MIDDLE = (
    "io",
    "measures",
    "simulation",
    "evaluation",
    "baselines",
    "study",
    "strap_search",
    "report",
    "manuscript",
    "benchmark",
    "streams",
    "app",
)
#: Subpackages of `smoother` (and `calib`) that each part may import, besides the core and itself.
MAY: dict[str, set[str]] = {
    "core": set(),
    "calib": set(),
    "io": {"calib"},
    "measures": set(),
    "simulation": {"calib"},
    "baselines": set(),
    "strap_search": {"calib", "io"},
    "evaluation": {"calib", "io", "baselines", "measures"},
    "study": {"calib", "io", "evaluation", "measures"},
    "report": {"calib", "io", "evaluation", "measures", "benchmark"},
    "manuscript": {"baselines", "evaluation"},
    "benchmark": {"calib", "io", "evaluation"},
    "streams": {"calib", "io"},
    "app": {"io"},
    "cli": {"calib", *MIDDLE},
    "unocclude": {"io", "measures", "simulation"},
}
#: Packages that make a command slow to start, or that need system libraries: imported where they are used.
HEAVY = {"open3d", "cv2", "plotly", "vqf", "libusb_package", "rich", "gtsam", "pylsl", "foxglove"}
#: What may be at the top of a module all the same: the graph's own files, and the report's plots.
AT_THE_TOP = {"smoother/graph": "gtsam", "smoother/report": "plotly"}
#: Words that the glossary replaced: no public name is made of them.
REPLACED = set(
    [
        "sight",
        "sights",
        "inertia",
        "piece",
        "pieces",
        "carry",
        "pulls",
        "tell",
        "told",
        "heard",
        "knowledge",
        "liveliness",
        "quiet",
        "knocks",
        "rough",
        "made_up",
        "steady",
        "thin",
        "flex",
        "believed",
        "honest",
        "bold",
        "shy",
        "room",
        "tidy",
        "let_go",
        "peer",
        "peers",
    ]
)
#: Names that standard words replaced: no class, function or constant has them.
REPLACED_NAMES = set(
    [
        "ends_the_process",
        "units_said",
        "UNSAID",
        "set_back",
        "_gone_on",
        "drop_outlying",
        "Carrying",
        "bead_clouds",
        "Outgoing",
        "Fingerprint",
        "Attendance",
        "LACKS",
        "BENT",
        "OPPOSITE",
        "Follower",
        "Succession",
        "Jump",
        "Ending",
        "held_calibration",
        "naming",
        "naming_the_cause",
        "judged",
        "bring",
        "Settled",
        "settle",
        "WideTurns",
        "deceive",
        "dim_belly",
    ]
)


def python_files(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


@cache
def parsed(text: str) -> ast.Module:
    """A file's tree; several rules look at each."""
    return ast.parse(text)


def tree_of(path: Path) -> ast.Module:
    return parsed(path.read_text(encoding="utf-8"))


def part_of(path: Path) -> str:
    """The part of the house that a file belongs to."""
    first, *rest = path.relative_to(ROOT).with_suffix("").parts
    return "calib" if first == "calib" else rest[0] if len(rest) > 1 and rest[0] in MAY else "core"


def floor_of(name: str) -> int | None:
    """The floor of the core that a part of `smoother` lies on; None where it is not of the core."""
    return next((floor for floor, parts in enumerate(STACK) if name in parts), None)


def imports(tree: ast.AST, inside_functions: bool) -> Iterator[tuple[int, str, list[str]]]:
    """Relative level, module and names of every import; those under TYPE_CHECKING are no imports."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and not inside_functions:
            continue
        if isinstance(node, ast.Import):
            yield from ((0, alias.name, []) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.level, node.module or "", [alias.name for alias in node.names]
        yield from imports(node, inside_functions)


def absolute(path: Path, level: int, module: str, names: list[str]) -> list[str]:
    """Full names of the modules that an import may mean."""
    if level:
        package = path.relative_to(ROOT).parts[:-1]
        base = [*package[: len(package) - level + 1], *([module] if module else [])]
        module = ".".join(base)
    return [module, *(f"{module}.{name}" for name in names)]


def imported_parts(path: Path) -> set[str]:
    """Parts of the house that a file imports, in functions too."""
    found = set()
    for level, module, names in imports(tree_of(path), inside_functions=True):
        for name in absolute(path, level, module, names):
            first, *rest = name.split(".")
            if first == "calib":
                found.add("calib")
            elif first == "smoother" and rest and rest[0] in MAY:
                found.add(rest[0])
    return found


def test_imports_point_down():
    for path in python_files("smoother", "calib"):
        part = part_of(path)
        wrong = imported_parts(path) - MAY[part] - {part}
        assert not wrong, f"{path.relative_to(ROOT)} belongs to {part} and imports {', '.join(sorted(wrong))}"


def core_imports(path: Path) -> set[str]:
    """Parts of the core that a file imports, in functions too."""
    found = set()
    for level, module, names in imports(tree_of(path), inside_functions=True):
        for name in absolute(path, level, module, names):
            first, *rest = name.split(".")
            if first == "smoother" and rest and floor_of(rest[0]) is not None:
                found.add(rest[0])
    return found


def test_the_core_is_one_stack():
    for path in python_files("smoother"):
        floor = floor_of(path.relative_to(ROOT).with_suffix("").parts[1])
        if floor is None:
            continue
        above = {name for name in core_imports(path) if (floor_of(name) or 0) > floor}
        assert not above, f"{path.relative_to(ROOT)} imports {', '.join(sorted(above))} from above"


def test_every_part_of_the_core_has_a_floor():
    parts = {path.relative_to(ROOT).with_suffix("").parts[1] for path in python_files("smoother")}
    assert parts - set(MAY) - {"__init__"} == {name for floor in STACK for name in floor}


def test_the_rule_finds_what_it_forbids(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    (tmp_path / "smoother" / "io").mkdir(parents=True)
    (tmp_path / "smoother" / "window").mkdir()
    core, inner = tmp_path / "smoother" / "smoothing.py", tmp_path / "smoother" / "io" / "b.py"
    core.write_text("def f():\n    from .io import reading\n    import calib.file\n")
    inner.write_text("from ..cli import run\nfrom .. import report\nfrom ..recording import JOINTS\n")
    assert (part_of(core), imported_parts(core)) == ("core", {"io", "calib"})
    assert (part_of(inner), imported_parts(inner)) == ("io", {"cli", "report"})
    low = tmp_path / "smoother" / "window" / "cut.py"
    low.write_text("from ..recovery.sections import Section\nfrom ..recording import JOINTS\n")
    assert core_imports(low) == {"recovery", "recording"}


def imported_files(path: Path) -> set[Path]:
    """Files of the house that a file imports: in functions and for its annotations too."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if not isinstance(node, ast.ImportFrom):
            continue
        names = [alias.name for alias in node.names]
        module, *members = absolute(path, node.level, node.module or "", names)
        files = {file for name in members if (file := file_of(name))}
        face = file_of(module)
        # a package's face is used where it hands on a name itself
        if face and (face.name != "__init__.py" or len(files) < len(members)):
            files.add(face)
        found |= files
    return found - {path}


def file_of(module: str) -> Path | None:
    """The file of a module's full name; None where it is none of the house."""
    place = ROOT.joinpath(*module.split("."))
    return next((p for p in (place.with_suffix(".py"), place / "__init__.py") if p.is_file()), None)


def circle_of(graph: dict[Path, set[Path]]) -> list[Path]:
    """Files that import each other; empty where none do."""
    left = dict(graph)
    while free := [path for path, used in left.items() if not used & left.keys()]:
        for path in free:
            del left[path]
    # what is left imports a circle or is in one: go down until a file comes again
    trip: list[Path] = [min(left)] if left else []
    while trip and trip[-1] not in trip[:-1]:
        trip.append(min(left[trip[-1]] & left.keys()))
    return trip[trip.index(trip[-1]) :] if trip else []


def test_no_files_import_each_other():
    circle = circle_of({path: imported_files(path) for path in python_files("smoother", "calib")})
    assert not circle, " imports ".join(str(path.relative_to(ROOT)) for path in circle)


def test_a_circle_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    folder = tmp_path / "smoother" / "io"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("from .a import a\n")
    (folder / "a.py").write_text("from .b import b\n")
    (folder / "b.py").write_text("def f():\n    from . import a\n")
    (folder / "c.py").write_text("from . import a\n")
    paths = python_files("smoother")
    assert circle_of({path: imported_files(path) for path in paths}) == [
        folder / n for n in ("a.py", "b.py", "a.py")
    ]
    (folder / "b.py").write_text("b = 1\n")
    assert not circle_of({path: imported_files(path) for path in paths})


def public_names(path: Path) -> Iterator[str]:
    """Classes, functions, methods and attributes that a module shows."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name
        if isinstance(node, ast.ClassDef):
            yield from (
                e.target.id
                for e in node.body
                if isinstance(e, ast.AnnAssign) and isinstance(e.target, ast.Name)
            )


def test_no_class_name_twice():
    places: dict[str, list[str]] = {}
    for path in python_files("smoother", "calib"):
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_no_module_name_twice_in_a_subject():
    """The core and `calib`: one name, one module, whatever folder it is in."""
    for subject in ([p for p in python_files("smoother") if part_of(p) == "core"], python_files("calib")):
        names = [path.stem for path in subject if path.stem != "__init__"]
        assert not {name for name in names if names.count(name) > 1}


def test_words_that_the_glossary_replaced_are_gone():
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in python_files("smoother", "calib")
        for name in public_names(path)
        if not name.startswith("_") and name.lower() in REPLACED
    ]
    assert not wrong


def test_names_that_standard_words_replaced_are_gone():
    wrong = []
    for path in python_files("smoother", "calib", "tools"):
        for node in ast.walk(tree_of(path)):
            name = getattr(node, "name", None) or (
                node.id if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else None
            )
            if name in REPLACED_NAMES:
                wrong.append(f"{path.relative_to(ROOT)}: {name}")
    assert not wrong


def test_heavy_packages_wait():
    for path in python_files("smoother", "calib"):
        name = path.relative_to(ROOT).as_posix()
        tree = tree_of(path)
        top = {module.split(".")[0] for level, module, _ in imports(tree, False) if not level}
        allowed = {package for place, package in AT_THE_TOP.items() if name.startswith(place)}
        assert not top & HEAVY - allowed, f"{name} imports {top & HEAVY - allowed} at its top"


def test_the_command_line_starts_light():
    code = (
        "import sys\n"
        "from smoother.cli.run import run\n"
        "assert run(['--help']) == 0 and run(['smooth', '--help']) == 0\n"
        "loaded = {'gtsam', 'open3d', 'cv2', 'plotly', 'scipy', 'vqf', 'mcap'} & set(sys.modules)\n"
        "assert not loaded, loaded\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("package", ["smoother", "smoother.io", "unocclude"])
def test_all_that_a_package_names_is_there(package: str):
    module = importlib.import_module(package)
    for name in module.__all__:  # a name whose module has moved fails here, with the module's name
        getattr(module, name)


def test_no_module_without_a_word_on_it():
    for path in python_files("smoother", "calib", "tools"):
        assert ast.get_docstring(tree_of(path)), path
