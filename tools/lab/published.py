"""What is published of experiments: one file of figures, from which every number of README and docs/results comes.

`python -m tools.lab publish DATA` runs the commands of `MEASUREMENTS` in a folder of scenes. Each puts its page between
its marks in a document, its pictures beside that, and its figures into figures.json, with the command, the machine, the
commit, the date and the seconds that they took. Sentences are written by hand, around the marks: `unsourced` finds a
number that no figure has, `unchecked` a comparison that no figure is asked about.

A comparison is followed by a comment such as `<!-- true: max(rd-fox[airgs].kb) < rd-fox[!airgs].kb -->`, which
`holds` evaluates. NAME[CELLS].COLUMN is the column of the rows of a table that have all CELLS, parted by semicolons,
and none of those with a !; without CELLS of all rows. NAME is a measurement, whose table of this name or first table is
meant, or a table. What is not a letter or a digit in the name of a column is an underscore. Of several values all must
be so.
"""

from __future__ import annotations

import ast
import dataclasses
import datetime
import json
import operator
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import ConfigError
from airgs_codec.places.whole import to_json, write_bytes
from tools.lab.experiments import MEASUREMENTS, Measurement
from tools.lab.page import Made, Page, Table, body_of, markdown_table, picture_link, update

REPOSITORY = Path(__file__).parents[2]
RESULTS = REPOSITORY / "docs" / "results"
FIGURES = RESULTS / "figures.json"
README = REPOSITORY / "README.md"
CODE = ("airgs_codec", "tools", "web/src")  # what a measurement depends on
LINE = 110  # characters of a value that stay on one line of figures.json
NOT_PROSE = re.compile(r"```.*?```|`[^`]*`|<!--.*?-->|\]\([^)]*\)", re.DOTALL)
# A name with a number in it, or a reference, is no figure.
NAME = re.compile(
    r"\b(SH|SH of degree|QP|Algorithm|Python|H|PyAV|numba|torch|splat4d|fourdgs|Apache|CC-BY|format|version|arXiv"
    r"|CVPR|SIGGRAPH Asia|MMSys|NSDI|et al\.|x264|commit|Measured) [\w.+-]*\d[\w.+-]*|\w+/\w*#\d+"
)
NUMBER = re.compile(r"(?<![\w.,^#-])\d[\d,]*(?:\.\d+)?(?:e-?\d+)?(?!\w)")


def publish(measurement: Measurement, page: Page, made: Made, pictures: Path) -> None:
    """Put a page between its marks in documents, its pictures beside them, and its figures into figures.json.

    Marks of NAME get all that the page shows, those of NAME/PART+PART tables or pictures of these names. `pictures`:
    the folder where they are. Raises OSError.
    """
    shown = {one.name: picture_link(one) for section in page.sections for one in section.pictures}
    parts = {one.name: markdown_table(one) for one in page.tables()} | shown
    wanted = [(path, mark) for path in documents() for mark in marks_in(path) if mark.partition("/")[0] == made.name]
    for path, mark in wanted:
        names = [part for part in mark.partition("/")[2].split("+") if part]
        text = "\n\n".join([*(parts[part] for part in names), made.said()]) if names else body_of(page, made)
        update(path, mark, text)
    new = entry(measurement, page, made)
    new["pictures"] = [name for name in shown if any(f"{name}.png)" in path.read_text() for path, _ in wanted)]
    for name in new["pictures"]:
        shutil.copyfile(pictures / f"{name}.png", RESULTS / f"{name}.png")
    entries = read_figures() | {made.name: new}
    write_figures({one.name: entries[one.name] for one in MEASUREMENTS if one.name in entries})


def documents() -> list[Path]:
    return [README, *sorted(RESULTS.glob("*.md"))]


def marks_in(path: Path) -> list[str]:
    return MARK.findall(path.read_text(encoding="utf-8"))


def entry(measurement: Measurement, page: Page, made: Made) -> dict[str, Any]:
    """What figures.json says of a measurement: how it was made, and the rows of its tables."""
    how = {name: value for name, value in dataclasses.asdict(made).items() if name != "name"}
    tables = {one.name: _columns(one) for one in page.tables()}
    how["seconds"] = round(made.seconds, 1)
    more = {"document": measurement.document} | how | {"how": page.how}
    return more | {"pictures": [], "more": dict(page.more), "tables": tables}


def _columns(table: Table) -> dict[str, Any]:
    """A table with its names once; fractional numbers have six digits."""
    names = list(dict.fromkeys(name for row in table.rows for name in row))
    heads = {key: head for key, (head, _) in table.shown_columns().items()}
    rows = [[_short(row.get(name)) for name in names] for row in table.rows]
    return {"columns": names, "shown as": heads, "rows": rows}


def _short(value: Any) -> Any:
    return float(f"{value:.6g}") if isinstance(value, float) else value


def lines_of(value: Any, indent: int = 0, before: str = "", after: str = "") -> Iterator[str]:
    """JSON text, on one line where it is short, so that a change of a figure is a change of its line."""
    start = " " * indent
    whole = f"{start}{before}{to_json(value)}{after}"
    if len(whole) <= LINE or not isinstance(value, list | dict):
        yield whole
        return
    opened, closed = "{}" if isinstance(value, Mapping) else "[]"
    yield f"{start}{before}{opened}"
    names = [f"{json.dumps(name)}: " for name in value] if isinstance(value, Mapping) else [""] * len(value)
    parts = list(value.values()) if isinstance(value, Mapping) else value
    for number, (name, part) in enumerate(zip(names, parts, strict=True), 1):
        yield from lines_of(part, indent + 1, name, "," if number < len(parts) else "")
    yield f"{start}{closed}{after}"


def read_figures() -> dict[str, Any]:
    return dict(json.loads(FIGURES.read_text(encoding="utf-8"))) if FIGURES.exists() else {}


def write_figures(entries: Mapping[str, Any]) -> None:
    write_bytes(FIGURES, ("\n".join(lines_of(entries)) + "\n").encode())


def today_and_commit() -> tuple[str, str]:
    """Return the date, and the commit of the code, with a + where it has changed since."""
    head = _git("rev-parse", "--short", "HEAD")
    return datetime.date.today().isoformat(), head + ("+" if _git("status", "--porcelain", "--", *CODE) else "")


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=REPOSITORY, capture_output=True, text=True).stdout.strip()


def unsourced(text: str, entries: Mapping[str, Any]) -> list[str]:
    """The numbers of the prose and the tables of a document that are in no entry, as they are shown.

    A number is in an entry if a figure of it has the same digits when it is rounded as the number is, as it is or in
    percent, or if its command, a text of it or a check of the document says it. Code, links and names with numbers in
    them are no figures.
    """
    prose = NAME.sub(" ", NOT_PROSE.sub(" ", text))
    values, said = set(), set(NUMBER.findall(" ".join(CHECK.findall(text))))
    for one in entries.values():
        for leaf in _leaves(one):
            if isinstance(leaf, str):
                said |= set(NUMBER.findall(leaf))
            elif isinstance(leaf, int | float) and not isinstance(leaf, bool):
                values.add(abs(float(leaf)))
    return [shown for shown in NUMBER.findall(prose) if shown not in said and not _is_one_of(shown, values)]


def _is_one_of(shown: str, values: set[float]) -> bool:
    """Return whether some value, or a hundred times it, is what is shown when rounded alike."""
    digits = shown.replace(",", "")
    if "e" in digits:
        return any(float(digits) == float(f"{value:.0e}") for value in values)
    places = len(digits.partition(".")[2])
    return any(f"{factor * value:.{places}f}" == digits for value in values for factor in (1, 100))


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list):
        for part in value:
            yield from _leaves(part)
    else:
        yield value


MARK = re.compile(r"<!-- tools\.lab (\S+): begin -->")
MARKED = re.compile(r"<!-- tools\.lab (\S+): begin -->.*?<!-- tools\.lab \1: end -->", re.DOTALL)
CHECK = re.compile(r"<!--\s+true:\s(.*?)\s-->", re.DOTALL)
COMPARES = re.compile(r"\b(more|less|fewer|better|worse|than|times|twice|faster|slower|larger|smaller)\b")
SENTENCES = re.compile(r"(?<=[.?!])\s+(?!✓)|\n(?=[|-])")
REFERENCE = re.compile(r"([a-z][\w-]*)(?:\[([^\]]*)\])?\.(\w+)")
OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq,
    ast.NotEq: operator.ne, ast.USub: operator.neg, ast.And: np.logical_and,
}  # fmt: skip
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "min": np.min, "max": np.max, "sum": np.sum, "count": np.sum, "mean": np.mean, "abs": np.abs,
}  # fmt: skip


def unchecked(text: str) -> list[str]:
    """The sentences, items and rows written by hand in a document that compare and that no check follows."""
    prose = CHECK.sub("✓", re.sub(r"```.*?```|`[^`]*`", "", MARKED.sub("", text), flags=re.DOTALL))
    parts = [part for paragraph in prose.split("\n\n") for part in SENTENCES.split(paragraph)]
    return [part for part in parts if COMPARES.search(part) and "✓" not in part and not part.startswith("#")]


def holds(check: str, entries: Mapping[str, Any]) -> bool:
    """Return whether a check is true of figures. Raises ConfigError for what is not there, or no such expression."""
    values: dict[str, Any] = {}

    def column(match: re.Match[str]) -> str:
        values[name := f"v{len(values)}"] = _column(entries, *match.groups())
        return name

    try:
        return bool(np.all(_value(ast.parse(REFERENCE.sub(column, " ".join(check.split())), mode="eval").body, values)))
    except (SyntaxError, KeyError, TypeError) as error:
        raise ConfigError(f"{check}: expected comparisons of columns, got {error}") from error


def _column(entries: Mapping[str, Any], name: str, cells: str | None, column: str) -> NDArray[Any]:
    tables = entries[name]["tables"] if name in entries else {}
    for one in entries.values() if not tables else ():
        tables = tables or {key: table for key, table in one["tables"].items() if key == name}
    if not tables:
        raise ConfigError(f"{name}: no such measurement or table")
    table = tables.get(name) or next(iter(tables.values()))
    at = {re.sub(r"\W+", "_", key): number for number, key in enumerate(table["columns"])}
    wanted = [cell.strip() for cell in (cells or "").split(";") if cell]
    found = [
        row for row in table["rows"] if all((cell.lstrip("!") in map(str, row)) != (cell[0] == "!") for cell in wanted)
    ]
    if not found:
        raise ConfigError(f"{name}[{cells}]: no such row")
    return np.array([np.nan if row[at[column]] is None else row[at[column]] for row in found])


def _value(node: ast.AST, values: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(op=op, operand=operand):
            return OPERATORS[type(op)](_value(operand, values))
        case ast.BinOp(left=left, op=op, right=right):
            return OPERATORS[type(op)](_value(left, values), _value(right, values))
        case ast.BoolOp(op=op, values=parts):
            return reduce(OPERATORS[type(op)], (np.all(_value(part, values)) for part in parts))
        case ast.Compare(left=left, ops=ops, comparators=others):
            sides = [_value(one, values) for one in (left, *others)]
            pairs = zip(ops, pairwise(sides), strict=True)
            return reduce(np.logical_and, (OPERATORS[type(op)](*two) for op, two in pairs))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            return FUNCTIONS[name](_value(argument, values))
    raise TypeError(ast.dump(node))
