"""The mutants of a source file: mutmut's operators, applied one at a time.

The operators are those of mutmut 3 (numbers, strings, comparisons, arithmetic, boolean operators, arguments
left out or None, assignments of None, branches of a ternary). mutmut itself puts all mutants of a function
beside each other and cannot mutate what runs at import, properties and decorated functions; here each mutant
is a source of its own, so these are mutated as well.

Not mutated, because no answer can depend on it: annotations, type aliases, docstrings, imports, decorators,
what is raised with its text, and `strict` of `zip` (a guard against a fault of ours).
"""

from __future__ import annotations

import ast
import random
from collections.abc import Iterator
from dataclasses import dataclass

import libcst as cst
from libcst.metadata import MetadataWrapper
from mutmut.mutation.mutators import mutation_operators

_TRIVIAL = ("len", "isinstance")


@dataclass(frozen=True)
class Mutant:
    """One change of a file.

    Attributes
    ----------
    path : str
        Of the file, from the root.
    source : str
        The whole file with the change.
    change : str
        The lines that differ, before and after.
    """

    path: str
    source: str
    change: str


class SourceFile:
    """A file with every change that mutmut's operators make of it.

    Parameters
    ----------
    path : str
        Of the file, from the root.
    source : str
        Its text.
    """

    def __init__(self, path: str, source: str) -> None:
        self.path, self.source = path, source
        self._module = MetadataWrapper(cst.parse_module(source)).module
        visitor = _Changes()
        self._module.visit(visitor)
        self._changes = visitor.changes

    def __len__(self) -> int:
        return len(self._changes)

    def sample(self, most: int, seed: int) -> list[Mutant]:
        """At most this many mutants, drawn from a seed; each another program than the file and all others."""
        order = list(range(len(self)))
        random.Random(f"{seed} {self.path}").shuffle(order)
        drawn: dict[str, tuple[int, Mutant]] = {}
        programs = {_program(self.source)}
        for k in order:
            if len(drawn) == most:
                break
            changed = self._module.deep_replace(*self._changes[k])
            assert isinstance(changed, cst.Module)
            try:
                compile(changed.code, self.path, "exec")
            except (SyntaxError, ValueError):
                continue
            program = _program(changed.code)
            if program not in programs:
                programs.add(program)
                change = changed_lines(self.source, changed.code)
                drawn[program] = k, Mutant(self.path, changed.code, change)
        return [mutant for _, mutant in sorted(drawn.values(), key=lambda item: item[0])]


def changed_lines(before: str, after: str) -> str:
    """`old lines -> new lines`, without indentation."""
    old, new = before.splitlines(), after.splitlines()
    while old and new and old[0] == new[0]:
        old, new = old[1:], new[1:]
    while old and new and old[-1] == new[-1]:
        old, new = old[:-1], new[:-1]
    old_text, new_text = (" ".join(" ".join(lines).split()) for lines in (old, new))
    return f"{old_text} -> {new_text}"


def _program(source: str) -> str:
    """What is the same for sources that differ in layout only."""
    return ast.dump(ast.parse(source))


class _Changes(cst.CSTVisitor):
    """Nodes with what they are replaced by."""

    def __init__(self) -> None:
        super().__init__()
        self.changes: list[tuple[cst.CSTNode, cst.CSTNode]] = []

    def on_visit(self, node: cst.CSTNode) -> bool:
        if _says_nothing(node):
            return False
        for kind, operator in mutation_operators:
            if isinstance(node, kind) and not _trivial(node):
                self.changes += [(node, new) for new in operator(node) if not _only_strict(node, new)]
        return True


def _says_nothing(node: cst.CSTNode) -> bool:
    """What no answer can depend on."""
    skipped = (cst.Annotation, cst.Decorator, cst.Import, cst.ImportFrom, cst.Raise)
    docstring = isinstance(node, cst.Expr) and isinstance(node.value, cst.SimpleString)
    strict = isinstance(node, cst.Arg) and node.keyword is not None and node.keyword.value == "strict"
    return isinstance(node, skipped) or docstring or strict or _alias(node)


def _trivial(node: cst.CSTNode) -> bool:
    """`len` and `isinstance`, which mutmut leaves alone: without an argument they do nothing but fail."""
    return isinstance(node, cst.Call) and isinstance(node.func, cst.Name) and node.func.value in _TRIVIAL


def _alias(node: cst.CSTNode) -> bool:
    """`Block = NDArray[np.uint8]`: a name for an annotation."""
    if not isinstance(node, cst.Assign) or not isinstance(node.value, cst.Subscript):
        return False
    target = node.targets[0].target
    return (
        isinstance(target, cst.Name) and target.value.lstrip("_")[:1].isupper() and not target.value.isupper()
    )


def _only_strict(old: cst.CSTNode, new: cst.CSTNode) -> bool:
    """Whether two calls differ in `strict` alone."""
    if not isinstance(old, cst.Call) or not isinstance(new, cst.Call) or old.func is not new.func:
        return False
    return list(map(id, _arguments(old))) == list(map(id, _arguments(new)))


def _arguments(call: cst.Call) -> Iterator[cst.Arg]:
    return (arg for arg in call.args if arg.keyword is None or arg.keyword.value != "strict")
