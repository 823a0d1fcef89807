"""What is published of experiments: one file of figures, from which every number of README and docs/results comes.

`python -m tools.lab publish DATA` runs the commands of `MEASUREMENTS` in a folder of scenes. Each puts its page between
its marks in a document, its pictures beside that, and its figures into figures.json, with the command, the machine, the
commit, the date and the seconds that they took. A number of these documents that no figure has is found by `unsourced`.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from airgs_codec.places.whole import to_json, write_bytes
from tools.lab.experiments import MEASUREMENTS, NO_LONGER_MEASURED, Measurement
from tools.lab.page import Made, Page, Table, body_of, markdown_table, update

REPOSITORY = Path(__file__).parents[2]
RESULTS = REPOSITORY / "docs" / "results"
FIGURES = RESULTS / "figures.json"
README = REPOSITORY / "README.md"
ANSWERS = "answers"  # the marks of what the first page of results shows
SENTENCE = re.compile(r"(?<=\.) (?=[A-Z])")  # its end
CODE = ("airgs_codec", "tools", "web/src")  # what a measurement depends on
LINE = 110  # characters of a value that stay on one line of figures.json
NOT_PROSE = re.compile(r"```.*?```|`[^`]*`|<!--.*?-->|\]\([^)]*\)", re.DOTALL)
# A name with a number in it, or a reference, is no figure.
NAME = re.compile(
    r"\b(SH|SH of degree|QP|Algorithm|Python|H|PyAV|numba|torch|splat4d|fourdgs|Apache|CC-BY|format|version|arXiv"
    r"|CVPR|SIGGRAPH Asia|MMSys|et al\.|x264|commit|Measured) [\w.+-]*\d[\w.+-]*|\w+/\w*#\d+"
)
NUMBER = re.compile(r"(?<![\w.,^#-])\d[\d,]*(?:\.\d+)?(?:e-?\d+)?(?!\w)")


def publish(measurement: Measurement, page: Page, made: Made, pictures: Path) -> None:
    """Put a page into its document, its pictures beside it, and its figures into figures.json.

    README gets what is brief of pages that it has marks for.

    `pictures`: the folder where they are. Raises ConfigError where the document has no marks for it, OSError.
    """
    update(RESULTS / f"{measurement.document}.md", made.name, body_of(page, made))
    if page.brief and f"tools.lab {made.name}: begin" in README.read_text(encoding="utf-8"):
        update(README, made.name, "\n\n".join(map(markdown_table, page.brief)))
    for picture in (picture for section in page.sections for picture in section.pictures):
        shutil.copyfile(pictures / f"{picture.name}.png", RESULTS / f"{picture.name}.png")
    entries = read_figures() | {made.name: entry(measurement, page, made)}
    order = [*(one.name for one in MEASUREMENTS), *NO_LONGER_MEASURED]
    kept = {name: entries[name] for name in order if name in entries}
    write_bytes(FIGURES, ("\n".join(lines_of(kept)) + "\n").encode())
    update(RESULTS / "README.md", ANSWERS, markdown_table(answers_of(kept)))


def answers_of(entries: Mapping[str, Any]) -> Table:
    """The pages of results, each with the first sentence of the first answer that was published of it."""
    rows, texts = [], {one.document: "" for one in MEASUREMENTS if one.document != "README"}
    for one in entries.values():
        if one["answers"] and one["document"] != "README" and not texts.get(one["document"]):
            texts[one["document"]] = SENTENCE.split(one["answers"][0])[0]
    for document, answer in texts.items():
        title = (RESULTS / f"{document}.md").read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        rows.append({"question": f"[{title}]({document}.md)", "answer": answer})
    return Table(ANSWERS, rows)


def entry(measurement: Measurement, page: Page, made: Made) -> dict[str, Any]:
    """What figures.json says of a measurement: how it was made, its answers, and the rows of its tables."""
    how = {name: value for name, value in dataclasses.asdict(made).items() if name != "name"}
    pictures = [picture.name for section in page.sections for picture in section.pictures]
    tables = {one.name: _columns(one) for one in page.tables()}
    how["seconds"] = round(made.seconds, 1)
    answers = [section.answer for section in page.sections if section.answer]
    more = {"document": measurement.document} | how | {"how": page.how, "answers": answers}
    return more | {"pictures": pictures, "more": dict(page.more), "tables": tables}


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


def today_and_commit() -> tuple[str, str]:
    """Return the date, and the commit of the code, with a + where it has changed since."""
    head = _git("rev-parse", "--short", "HEAD")
    return datetime.date.today().isoformat(), head + ("+" if _git("status", "--porcelain", "--", *CODE) else "")


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=REPOSITORY, capture_output=True, text=True).stdout.strip()


def unsourced(text: str, entries: Mapping[str, Any]) -> list[str]:
    """The numbers of the prose and the tables of a document that are in no entry, as they are shown.

    A number is in an entry if a figure of it has the same digits when it is rounded as the number is, as it is or in
    percent, or if an answer of it or its command says it. Code, links and names with numbers in them are no figures.
    """
    prose = NAME.sub(" ", NOT_PROSE.sub(" ", text))
    values, said = set(), set()
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
