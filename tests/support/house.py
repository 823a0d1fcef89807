"""Lengths of modules and of function bodies, and numbers of parameters, against the limits this project keeps.

A body is counted in lines without its docstring, `self` and `cls` are not counted as parameters. Functions that numba
compiles, the modules that hold only those, and the tables of the manifest are exempt.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

FOLDERS = ("airgs_codec", "tools")
MAX_MODULE, MAX_BODY, MAX_PARAMETERS = 350, 60, 6
EXEMPT_MODULES = {"render/cpu_kernels.py", "trainer/fit/kernels.py", "package/tables.py"}
COMPILED = {"njit", "jit", "vectorize", "guvectorize"}
Definition = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Function:
    """One function or method and its size."""

    where: str  # path:line name
    body: int  # lines
    parameters: int


@dataclass(frozen=True, slots=True)
class House:
    """What was measured in one folder; exempt functions and modules are not in it."""

    modules: dict[str, int]  # path -> lines
    functions: tuple[Function, ...]

    def excesses(self) -> list[str]:
        """One line for everything over a hard limit."""
        long = [f"{path}: {n} lines, at most {MAX_MODULE}" for path, n in self.modules.items() if n > MAX_MODULE]
        for f in self.functions:
            if f.body > MAX_BODY:
                long.append(f"{f.where}: {f.body} lines, at most {MAX_BODY}")
            if f.parameters > MAX_PARAMETERS:
                long.append(f"{f.where}: {f.parameters} parameters, at most {MAX_PARAMETERS}")
        return long

    def columns(self) -> dict[str, Sequence[int]]:
        """The three measured distributions."""
        return {
            "module lines": list(self.modules.values()),
            "body lines": [f.body for f in self.functions],
            "parameters": [f.parameters for f in self.functions],
        }


def measure(folder: Path) -> House:
    """All Python files below a folder; files that are empty do not count as modules."""
    modules: dict[str, int] = {}
    functions: list[Function] = []
    for path in sorted(folder.rglob("*.py")):
        text, name = path.read_text(encoding="utf-8"), path.relative_to(folder).as_posix()
        functions += _functions(ast.parse(text), f"{folder.name}/{name}")
        if text and name not in EXEMPT_MODULES:
            modules[f"{folder.name}/{name}"] = len(text.splitlines())
    return House(modules, tuple(functions))


def _functions(tree: ast.Module, path: str) -> Iterator[Function]:
    for node in ast.walk(tree):
        if isinstance(node, Definition) and not _is_compiled(node):
            yield Function(f"{path}:{node.lineno} {node.name}", _body_lines(node), _parameters(node))


def _is_compiled(node: Definition) -> bool:
    names = {n.id if isinstance(n, ast.Name) else n.attr for d in node.decorator_list for n in _names(d)}
    return bool(names & COMPILED)


def _names(decorator: ast.expr) -> Iterator[ast.Name | ast.Attribute]:
    return (n for n in ast.walk(decorator) if isinstance(n, ast.Name | ast.Attribute))


def _body_lines(node: Definition) -> int:
    statements = node.body[1:] if ast.get_docstring(node) is not None else node.body
    return statements[-1].end_lineno - statements[0].lineno + 1 if statements else 0  # type: ignore[operator]


def _parameters(node: Definition) -> int:
    a = node.args
    named = [*a.posonlyargs, *a.args, *a.kwonlyargs, *filter(None, (a.vararg, a.kwarg))]
    return len([p for p in named if p.arg not in ("self", "cls")])


def percentile(values: Sequence[int], share: float) -> int:
    """The smallest value that `share` of all values do not exceed (nearest rank); 0 of none."""
    return sorted(values)[max(0, math.ceil(share * len(values)) - 1)] if values else 0
