"""The house: imports point down, heavy packages wait until they are needed, files stay short."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MIDDLE = ("io", "simulation", "evaluation", "peers", "study", "report")
#: Subpackages of `smoother` (and `calib`) that each part may import, besides the core and itself.
MAY = {
    "core": set(),
    "calib": set(),
    "io": {"calib"},
    "simulation": {"calib"},
    "peers": {"calib"},
    "evaluation": {"calib", "io", "peers"},
    "study": {"calib", "io", "evaluation"},
    "report": {"calib", "io", "evaluation"},
    "cli": {"calib", *MIDDLE},
}
#: Packages that make a command slow to start, or that need system libraries: imported where they are used.
HEAVY = {"open3d", "cv2", "plotly", "vqf", "libusb_package", "rich", "gtsam"}
#: What may stand at the top of a module all the same: the graph's own files, and the report's plots.
AT_THE_TOP = {
    "smoother/graph.py": "gtsam",
    "smoother/solve.py": "gtsam",
    "smoother/marginals.py": "gtsam",
    "smoother/offset.py": "gtsam",
    "smoother/report": "plotly",
}
LONGEST = 350


def python_files(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def part_of(path: Path) -> str:
    """The part of the house that a file belongs to."""
    first, *rest = path.relative_to(ROOT).parts
    return "calib" if first == "calib" else rest[0] if len(rest) > 1 else "core"


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
    for level, module, names in imports(ast.parse(path.read_text(encoding="utf-8")), inside_functions=True):
        for name in absolute(path, level, module, names):
            first, *rest = name.split(".")
            if first == "calib":
                found.add("calib")
            elif first == "smoother" and rest and rest[0] in MAY:
                found.add(rest[0])
    return found


@pytest.mark.parametrize("path", python_files("smoother", "calib"), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_down(path: Path):
    part = part_of(path)
    wrong = imported_parts(path) - MAY[part] - {part}
    assert not wrong, f"{path.relative_to(ROOT)} belongs to {part} and imports {', '.join(sorted(wrong))}"


def test_the_rule_finds_what_it_forbids(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    (tmp_path / "smoother" / "io").mkdir(parents=True)
    core, inner = tmp_path / "smoother" / "a.py", tmp_path / "smoother" / "io" / "b.py"
    core.write_text("def f():\n    from .io import reading\n    import calib.file\n")
    inner.write_text("from ..cli import run\nfrom .. import report\nfrom ..recording import JOINTS\n")
    assert (part_of(core), imported_parts(core)) == ("core", {"io", "calib"})
    assert (part_of(inner), imported_parts(inner)) == ("io", {"cli", "report"})


def test_heavy_packages_wait():
    for path in python_files("smoother", "calib"):
        name = path.relative_to(ROOT).as_posix()
        tree = ast.parse(path.read_text(encoding="utf-8"))
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


def test_files_stay_short():
    long = {
        str(path.relative_to(ROOT)): count
        for path in python_files("smoother", "calib", "tools", "tests")
        if (count := len(path.read_text(encoding="utf-8").splitlines())) > LONGEST
    }
    assert not long


def test_no_module_without_a_word_on_it():
    for path in python_files("smoother", "calib", "tools"):
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), path
