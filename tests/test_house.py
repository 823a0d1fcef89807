"""The house only gets smaller, functions stay short, modules say what they are for, and generated files are fresh."""

import ast
import json
import re

import pytest

import airgs_codec
from tests.support.house import TABLE, complaints, long_functions, lowered, nodes, sizes
from tests.support.paths import PACKAGE, REPOSITORY
from tools import typescript

NAMED = r"^class (\w+)|^([A-Z][A-Z_0-9]+)(?:: .*?)? = "
SMALL, LARGE = {"files": 1, "lines": 100}, {"files": 1, "lines": 104}


def test_no_folder_has_grown_and_entries_are_only_lowered():
    assert list(complaints(json.loads(TABLE.read_text(encoding="utf-8")), sizes())) == []
    assert lowered({"a": SMALL, "b": LARGE}, {"a": LARGE, "b": SMALL}) == {"a": SMALL, "b": SMALL}


@pytest.mark.parametrize(("entries", "found", "wanted"), [
    ({"a": SMALL}, {"a": SMALL}, []),
    ({"a": SMALL}, {"a": LARGE}, ["a: 104 lines, at most 100; take something away"]),
    ({"a": LARGE}, {"a": SMALL}, ["a: 100 lines, so lower its entry of 104"]),
    ({}, {"a": SMALL}, [f"a: {what}, at most 0; take something away" for what in ("1 files", "100 lines")]),
    ({"a": SMALL}, {}, ["a: it is gone, so take its entry out"]),
])  # fmt: skip
def test_what_is_said_of_a_folder(entries, found, wanted):
    assert list(complaints(entries, found)) == wanted


def test_no_function_is_long_but_a_kernel_may_be(tmp_path):
    assert [line for folder in (PACKAGE, REPOSITORY / "tools") for line in long_functions(folder)] == []
    body = "".join(f"    x = {i}\n" for i in range(81))
    kernel = f"@nb.njit(cache=True)\ndef kernel():\n{body}"
    (tmp_path / "long.py").write_text(f'def long():\n    """Words do not count."""\n{body}{kernel}')
    assert list(long_functions(tmp_path)) == ["long.py:1 long: 81 lines, at most 80"]


def test_whatever_is_public_and_every_module_says_what_it_is_for():
    public = {name: getattr(airgs_codec, name) for name in airgs_codec.__all__}
    assert [name for name, value in public.items() if callable(value) and not value.__doc__] == []
    modules = {path: nodes(path)[0] for path in PACKAGE.rglob("*.py")}
    assert [path for path, module in modules.items() if module.body and not ast.get_docstring(module)] == []


def test_files_for_typescript_are_what_python_says():
    made, folder = typescript.files(), typescript.FOLDER
    assert {path.name for path in folder.iterdir()} == set(made)
    stale = [name for name, text in made.items() if (folder / name).read_text(encoding="utf-8") != text]
    assert not stale, f"{', '.join(stale)}: older than airgs_codec; run python -m tools.typescript and commit"
    sources = "\n".join(path.read_text() for path in folder.parent.rglob("*.ts") if folder not in path.parents)
    names = [line.split()[2].rstrip(":") for line in made["constants.ts"].splitlines() if line.startswith("export")]
    assert names and [name for name in names if not re.search(rf"\b{name}\b", sources)] == []


def test_no_class_or_constant_has_two_meanings():
    modules = sorted(PACKAGE.rglob("*.py"))
    named = [name for path in modules for name in re.findall(NAMED, path.read_text(encoding="utf-8"), re.MULTILINE)]
    names = [a or b for a, b in named]
    assert sorted({name for name in names if names.count(name) > 1}) == []
