"""CSV, Markdown and one HTML page of a reproduction."""

from __future__ import annotations

import csv
import html
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from airgs_codec._report import page
from airgs_codec.media.h264 import library_versions
from tools.reproduction.published import PROTOCOL, TABLE

# Title -> rows, and the headings of the columns that are shown.
Tables = Mapping[str, tuple[Sequence[Mapping[str, Any]], Mapping[str, str]]]

PICTURES = {
    "quality.png": "PSNR of every frame at the held-out cameras; dots are keyframes.",
    "sizes.png": "PSNR over bytes a frame, keys and tables counted.",
    "times.png": "How long a frame takes over the links, by bits over the rate at its moment.",
    "pruning.png": "What pruning updates costs and saves.",
    "ablations.png": "One setting of the trainer changed at a time.",
}


def machine() -> dict[str, str]:
    """What the figures were made with."""
    versions = library_versions() | {"numpy": np.__version__, "torch": torch.__version__}
    cores = f"{os.cpu_count()} cores of {platform.machine()}"
    return {"machine": cores, "python": platform.python_version(), **{n: str(v) for n, v in versions.items()}}


def write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """A row a mapping; columns are what is a single value in the first."""
    columns = [name for name, value in rows[0].items() if not isinstance(value, list)]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


def published_table() -> list[dict[str, Any]]:
    """The paper's tables, as rows."""
    return [asdict(row) for row in TABLE]


def write_markdown(tables: Tables, path: Path) -> None:
    """The tables one after another, each under its heading."""
    parts = [f"## {title}\n\n{_markdown(rows, columns)}\n" for title, (rows, columns) in tables.items()]
    path.write_text("\n".join(parts))


def write_page(tables: Tables, folder: Path) -> None:
    """index.html with every table under its heading and the pictures that are in the folder."""
    parts = [f"<p>{html.escape(', '.join(f'{n} {v}' for n, v in machine().items()))}.</p>"]
    for title, (rows, columns) in tables.items():
        parts.append(f"<h2>{html.escape(title)}</h2>{_html_table(rows, columns)}")
    parts.append(f"<p>{html.escape(PROTOCOL)}</p>")
    for name, words in PICTURES.items():
        if (folder / name).exists():
            parts.append(f'<figure><img src="{name}" alt=""><figcaption>{html.escape(words)}</figcaption></figure>')
    style = "td,th{padding:.15rem .8rem;text-align:right}td:first-child,th:first-child{text-align:left}"
    (folder / "index.html").write_text(page("The paper's experiments", "".join(parts), style=style))


def _markdown(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    lines = [f"| {' | '.join(columns.values())} |", f"|{'---|' * len(columns)}"]
    lines += [f"| {' | '.join(_cell(row.get(name)) for name in columns)} |" for row in rows]
    return "\n".join(lines)


def _html_table(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> str:
    head = "".join(f"<th>{html.escape(title)}</th>" for title in columns.values())
    cells = ("".join(f"<td>{html.escape(_cell(row.get(name)))}</td>" for name in columns) for row in rows)
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
