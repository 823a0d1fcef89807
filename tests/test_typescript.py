"""web/src/generated is what Python says today."""

import re
from pathlib import Path

from tools.typescript import FOLDER, files

SOURCES = FOLDER.parent


def test_the_committed_files_are_what_python_says():
    made = files()
    assert {path.name for path in FOLDER.iterdir()} == set(made)
    stale = [name for name, text in made.items() if (FOLDER / name).read_text(encoding="utf-8") != text]
    assert not stale, f"{', '.join(stale)}: older than airgs_codec; run python -m tools.typescript and commit"


def test_no_constant_is_there_that_typescript_does_not_use():
    sources = "\n".join(path.read_text(encoding="utf-8") for path in _sources())
    names = [line.split()[2].rstrip(":") for line in files()["constants.ts"].splitlines() if line.startswith("export")]
    assert names
    assert [name for name in names if not re.search(rf"\b{name}\b", sources)] == []


def _sources() -> list[Path]:
    return [path for path in SOURCES.rglob("*.ts") if FOLDER not in path.parents]
