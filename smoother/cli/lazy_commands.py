"""Commands that are imported when they are asked for: one that runs does not wait for all the others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup


@dataclass(frozen=True)
class CommandSpec:
    """Where a command is.

    Attributes
    ----------
    module : str
        Of this package; its function has the command's name, with `_` for `-`.
    epilog : str
        What stands below its help: an example.
    cls : str
        The command's class in the module, where it is not typer's.
    has_settings : bool
        The module's `settings()` become options too.
    """

    module: str
    epilog: str
    cls: str = ""
    has_settings: bool = False

    def command(self, name: str) -> Any:
        """The command, imported now."""
        module = import_module(f".{self.module}", __package__)
        function = getattr(module, name.replace("-", "_"))
        if self.has_settings:
            from .simulation_settings import with_settings

            function = with_settings(function, module.settings())
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        app.command(name, cls=getattr(module, self.cls) if self.cls else None, epilog=self.epilog)(function)
        return typer.main.get_command(app)


class LazyCommands(Mapping[str, Any]):
    """Commands by name; each is imported when it is looked up.

    Parameters
    ----------
    specs : mapping of str to CommandSpec
    groups : mapping
        Groups by name, as typer made them; they come last.
    """

    def __init__(self, specs: Mapping[str, CommandSpec], groups: Mapping[str, Any]) -> None:
        self._specs, self._commands = specs, dict(groups)
        self._names = [*specs, *groups]

    def __getitem__(self, name: str) -> Any:
        if name not in self._commands:
            self._commands[name] = self._specs[name].command(name)
        return self._commands[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def lazy_group(specs: Mapping[str, CommandSpec]) -> type[TyperGroup]:
    """A kind of group that holds commands.

    Parameters
    ----------
    specs : mapping of str to CommandSpec
        By the commands' names, in the order of the help.

    Returns
    -------
    group : type
        For `typer.Typer(cls=...)`.
    """

    class LazyGroup(TyperGroup):
        def __init__(self, *, commands: Any = None, **attributes: Any) -> None:
            super().__init__(commands=commands, **attributes)
            self.commands = LazyCommands(specs, self.commands)  # type: ignore[assignment]

        def list_commands(self, ctx: Any) -> list[str]:
            return list(self.commands)

    return LazyGroup
