"""Packages that an extra of the program installs: there, or a sentence that says how to get them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

from ..errors import UnoccludeError


def extra_module(
    name: str, package: str, extra: str, needs: Sequence[str] = (), submodules: Sequence[str] = ()
) -> ModuleType:
    """A module of an extra.

    Parameters
    ----------
    name : str
        As it is imported.
    package : str
        As it is installed.
    extra : str
        Of this program, that installs it.
    needs : sequence of str
        Names in it that an old version lacks.
    submodules : sequence of str
        What is to be imported with it.

    Returns
    -------
    module : ModuleType

    Raises
    ------
    UnoccludeError
        It is not installed, or too old; the sentence says how to get it.
    """
    try:
        module = import_module(name)
        for submodule in submodules:
            import_module(f"{name}.{submodule}")
    except ImportError as error:
        raise UnoccludeError(
            f"this needs {package}, which is not installed; get it with `pip install '.[{extra}]'`"
            " in the program's folder"
        ) from error
    if not all(hasattr(module, need) for need in needs):
        version = getattr(module, "__version__", "")
        raise UnoccludeError(
            f"{package}{f' {version}' if version else ''} is too old; `pip install -U '.[{extra}]'` in the"
            " program's folder"
        )
    return module
