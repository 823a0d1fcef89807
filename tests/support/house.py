"""How large each folder is, against the entries of tests/house.json, which only go down; and functions that are long.

`python -m tests.support.house` lowers every entry to what is there, and takes folders out that are gone.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.support.paths import REPOSITORY

TABLE = REPOSITORY / "tests" / "house.json"
ENDINGS = {"airgs_codec": {".py"}, "tools": {".py"}, "tests": {".py"}, "web/src": {".ts", ".css"}}
SLACK = 1.03  # an entry above this many times what is there is to be lowered
LONGEST = 80  # lines of a function without its docstring
COMPILED = {"njit", "jit", "vectorize", "guvectorize"}  # decorators of kernels, which may be longer
Size = dict[str, int]  # files and lines


def sizes(repository: Path = REPOSITORY) -> dict[str, Size]:
    """Files and lines of each folder that has an entry: those of ENDINGS, and those in airgs_codec."""
    parts = sorted(path for path in (repository / "airgs_codec").iterdir() if path.is_dir() and path.stem[0] != "_")
    found = {}
    for name, endings in (ENDINGS | {f"airgs_codec/{part.name}": {".py"} for part in parts}).items():
        files = [path for path in (repository / name).rglob("*") if path.suffix in endings]
        found[name] = {"files": len(files), "lines": sum(path.read_bytes().count(b"\n") for path in files)}
    return found


def complaints(entries: dict[str, Size], found: dict[str, Size]) -> Iterator[str]:
    """A line for each folder that is larger than its entry, has none, or whose entry is to be lowered or taken out."""
    for name in entries.keys() - found.keys():
        yield f"{name}: it is gone, so take its entry out"
    for name, size in found.items():
        for what, count in size.items():
            entry = entries.get(name, {}).get(what, 0)
            if count > entry:
                yield f"{name}: {count} {what}, at most {entry}; take something away"
            elif entry > SLACK * count:
                yield f"{name}: {count} {what}, so lower its entry of {entry}"


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def long_functions(folder: Path) -> Iterator[str]:
    """A line for each function of more than LONGEST lines that numba does not compile."""
    for path in sorted(folder.rglob("*.py")):
        for node in nodes(path):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            parts = [part for decorator in node.decorator_list for part in ast.walk(decorator)]
            if not any(getattr(part, "id", getattr(part, "attr", "")) in COMPILED for part in parts):
                body = node.body[1:] if ast.get_docstring(node) is not None else node.body
                lines = (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0
                if lines > LONGEST:
                    yield f"{path.relative_to(folder)}:{node.lineno} {node.name}: {lines} lines, at most {LONGEST}"


def lowered(entries: dict[str, Size], found: dict[str, Size]) -> dict[str, Size]:
    """The entries of folders that are there, none of them above what is there."""
    least = {name: {what: min(n, size[what]) for what, n in found[name].items()} for name, size in entries.items()}
    return {name: least[name] for name in found if name in least}


if __name__ == "__main__":
    was = json.loads(TABLE.read_text(encoding="utf-8"))
    rows = lowered({name: size for name, size in was.items() if name in sizes()}, sizes()).items()
    TABLE.write_text("{\n" + ",\n".join(f' "{name}": {json.dumps(size)}' for name, size in rows) + "\n}\n")
