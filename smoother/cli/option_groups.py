"""Options that several commands share, as one parameter: a dataclass, whose fields are the options."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_type_hints


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of its groups, in the groups' places.

    Parameters
    ----------
    command : callable
        Parameters whose type is a dataclass stand for its fields, which are annotated as options.

    Returns
    -------
    command : callable
        For typer, under the same name.
    """
    own = inspect.signature(command, eval_str=True).parameters
    kinds = {name: each.annotation for name, each in own.items() if isinstance(each.annotation, type)}
    groups = {name: kind for name, kind in kinds.items() if is_dataclass(kind)}

    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{each.name: values.pop(each.name) for each in fields(group)})
        command(**values)

    parameters: list[inspect.Parameter] = []
    for name, parameter in own.items():
        parameters += _options(groups[name]) if name in groups else [parameter]
    return with_signature(run, command, parameters)


def with_signature(
    run: Callable[..., None], command: Callable[..., None], parameters: list[inspect.Parameter]
) -> Callable[..., None]:
    """`run` under the command's name and help, with these parameters, as typer reads them."""
    # keyword-only throughout: options have no order
    parameters = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in parameters]
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def _options(group: type[Any]) -> list[inspect.Parameter]:
    kinds = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            each.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if each.default is MISSING else each.default,
            annotation=kinds[each.name],
        )
        for each in fields(group)
    ]
