"""docs/measures.md names every measure and every setting, and states its default."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from smoother.measures import MeasureSettings
from smoother.measures.definitions import ANGLE_WORDS, definitions

PAGE = (Path(__file__).parents[2] / "docs" / "measures.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("key", definitions())
def test_every_measure_is_there(key: str):
    angle = next(
        (name for name in sorted(ANGLE_WORDS, key=len, reverse=True) if key.startswith(f"{name}_")), None
    )
    if angle is None:
        assert f"`{key}`" in PAGE
    else:
        assert f"`{angle.removesuffix('_trunk')}`" in PAGE and f"`ANGLE{key.removeprefix(angle)}`" in PAGE


def test_every_setting_is_there_with_its_default():
    table = PAGE[PAGE.index("## Settings") :]
    for name, field in MeasureSettings.model_fields.items():
        group = field.default
        assert isinstance(group, BaseModel) and f"`[{name}]`" in table
        for leaf, value in group.model_dump().items():
            rows = [row for row in table.splitlines() if row.startswith("|") and f"`{leaf}`" in row]
            assert rows, leaf
            numbers = [float(text) for row in rows for text in re.findall(r"[\d.]+", row.split("|")[2])]
            assert value is None or value in numbers, leaf
