"""Codes of a key -> values of the canonical space (FORMAT.md, sections 4 and 5)."""

from __future__ import annotations

from tests.makers.vectors.formulas import coding_of, key_row, listed
from tests.makers.vectors.text import Table
from tests.support.vectors import Case, cases


def table() -> Table:
    return {"cases": [case | _expected(case) for case in cases("keys")]}


def _expected(case: Case) -> Case:
    """All but the means, which codes of keys do not have."""
    rows = [key_row(codes, coding_of(case)) for codes in zip(*case["codes"], strict=True)]
    parts = listed(rows, limit=False)
    return {name: {key: one for key, one in part.items() if key != "means"} for name, part in parts.items()}
