"""The house only gets smaller, its functions stay short, and what is public or a module says what it is for."""

import ast
import json

import pytest

import airgs_codec
from tests.support.house import TABLE, complaints, long_functions, lowered, sizes
from tests.support.paths import REPOSITORY

SMALL, LARGE = {"files": 1, "lines": 100}, {"files": 1, "lines": 104}


def test_no_folder_has_grown():
    assert list(complaints(json.loads(TABLE.read_text(encoding="utf-8")), sizes())) == []


@pytest.mark.parametrize("folder", ["airgs_codec", "tools"])
def test_no_function_is_long(folder):
    assert list(long_functions(REPOSITORY / folder)) == []


@pytest.mark.parametrize(
    ("entries", "found", "wanted"),
    [
        ({"a": SMALL}, {"a": SMALL}, []),
        ({"a": SMALL}, {"a": LARGE}, ["a: 104 lines, at most 100; take something away"]),
        ({"a": LARGE}, {"a": SMALL}, ["a: 100 lines, so lower its entry of 104"]),
        ({}, {"a": SMALL}, [f"a: {what}, at most 0; take something away" for what in ("1 files", "100 lines")]),
        ({"a": SMALL}, {}, ["a: it is gone, so take its entry out"]),
    ],
)  # fmt: skip
def test_what_is_said_of_a_folder(entries, found, wanted):
    assert list(complaints(entries, found)) == wanted


def test_entries_are_only_lowered():
    assert lowered({"a": SMALL, "b": LARGE}, {"a": LARGE, "b": SMALL}) == {"a": SMALL, "b": SMALL}


def test_a_long_function_is_named_and_a_kernel_may_be_long(tmp_path):
    body = "".join(f"    x = {i}\n" for i in range(81))
    kernel = f"@nb.njit(cache=True)\ndef kernel():\n{body}"
    (tmp_path / "long.py").write_text(f'def long():\n    """Words do not count."""\n{body}{kernel}')
    assert list(long_functions(tmp_path)) == ["long.py:1 long: 81 lines, at most 80"]


@pytest.mark.parametrize("name", airgs_codec.__all__)
def test_what_is_public_says_what_it_is(name):
    value = getattr(airgs_codec, name)
    assert not callable(value) or value.__doc__


def test_every_module_says_what_it_is_for():
    for path in (REPOSITORY / "airgs_codec").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert not text or ast.get_docstring(ast.parse(text)), path


@pytest.mark.parametrize(("folder", "never"), [("airgs_codec", {"tools", "tests"}), ("tools", {"tests"})])
def test_imports_go_one_way(folder, never):
    """tests -> tools -> airgs_codec."""
    for path in (REPOSITORY / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [getattr(node, "module", None)]
            assert not never & {(name or "").split(".")[0] for name in names}, path


def test_nothing_private_is_imported_from_another_folder():
    """Modules of the root whose names begin with an underscore are shared by all."""
    for path in (REPOSITORY / "airgs_codec").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").count(".") > 1:
                private = [a.name for a in node.names if a.name.startswith("_") or "._" in (node.module or "")]
                assert not private or (node.module or "").split(".")[1] == path.parent.name, f"{path}: {private}"
