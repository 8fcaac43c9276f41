"""docs/quality.md: every requirement has tests, and each of them exists and can run."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import smoother

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "quality.md").read_text(encoding="utf-8")
REQUIREMENTS = re.findall(r"^\| (R\d+) \| (.+?) \| (.+) \|$", TEXT, re.MULTILINE)


@cache
def names_in(path: Path) -> frozenset[str]:
    """What pytest collects of a file, by name."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        inside = node.body if isinstance(node, ast.ClassDef) and node.name.startswith("Test") else [node]
        prefix = f"{node.name}::" if isinstance(node, ast.ClassDef) else ""
        names |= {
            prefix + each.name
            for each in inside
            if isinstance(each, ast.FunctionDef) and each.name.startswith("test_")
        }
    return frozenset(names)


def test_requirements_are_numbered_through() -> None:
    assert len(REQUIREMENTS) > 20
    assert [number for number, _, _ in REQUIREMENTS] == [f"R{n + 1}" for n in range(len(REQUIREMENTS))]
    anomalies = re.findall(r"^\| (A\d+) \|", TEXT, re.MULTILINE)
    assert anomalies == [f"A{n + 1}" for n in range(len(anomalies))] and anomalies


@pytest.mark.parametrize("number, requirement, tests", REQUIREMENTS, ids=[each[0] for each in REQUIREMENTS])
def test_each_has_tests_that_exist(number: str, requirement: str, tests: str) -> None:
    named = re.findall(r"`([^`]+)`", tests)
    assert named and requirement, number
    for each in named:
        file, _, name = each.partition("::")
        assert file.startswith("tests/") and (ROOT / file).is_file(), f"{number}: there is no {file}"
        assert name in names_in(ROOT / file), f"{number}: {file} has no {name}"


def test_the_anomalies_are_of_this_version() -> None:
    assert f"Version {smoother.__version__}." in TEXT
