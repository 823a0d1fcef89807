"""What several reports share: tables of text, and the frame of a page."""

from __future__ import annotations

import html


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of right-aligned columns under their headings."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    return ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]]


def page(title: str, body: str, width: str = "70rem", style: str = "") -> str:
    """An HTML page; `style` is CSS beside what every page has."""
    shared = (
        f"body{{font:15px/1.5 system-ui,sans-serif;max-width:{width};margin:2rem auto;padding:0 1rem;color:#222}}"
        "img{max-width:100%;margin-top:1rem}th{text-align:left;padding-right:2rem;font-weight:600}"
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{shared}{style}</style><h1>{html.escape(title)}</h1>{body}</html>\n"
    )
