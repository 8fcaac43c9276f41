"""A package of an extra: there, missing, too old, half there."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest

from smoother.errors import UnoccludeError
from smoother.runtime.packages import extra_module


@pytest.mark.parametrize("submodules", [(), ("blueprint",)])
def test_what_is_missing_is_asked_for(submodules: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", ModuleType("rerun") if submodules else None)
    with pytest.raises(UnoccludeError) as error:
        extra_module("rerun", "rerun-sdk", "view", submodules=submodules)
    sentence = (
        "this needs rerun-sdk, which is not installed; get it with `pip install '.[view]'` in the program's"
    )
    assert str(error.value) == f"{sentence} folder"


@pytest.mark.parametrize("version, said", [("0.9", "foxglove-sdk 0.9"), (None, "foxglove-sdk")])
def test_what_is_too_old_is_said(version: str | None, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    old = ModuleType("foxglove")
    old.Context = object  # type: ignore[attr-defined]
    if version is not None:
        old.__version__ = version  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "foxglove", old)
    assert extra_module("foxglove", "foxglove-sdk", "live", ["Context"]) is old
    with pytest.raises(UnoccludeError) as error:
        extra_module("foxglove", "foxglove-sdk", "live", ["Context", "start_server"])
    assert str(error.value) == f"{said} is too old; `pip install -U '.[live]'` in the program's folder"
