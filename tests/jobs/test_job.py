"""Names of content tell values apart by what they hold, and names of code tell functions apart by what they run."""

import ast
import shutil
import subprocess
import sys
from dataclasses import make_dataclass
from functools import partial

import numpy as np
import pytest
from airgs_codec.jobs.job import code_digest, digest, modules_run

from tests.faces import EncodeSettings
from tests.support.jobs import square
from tests.support.paths import PACKAGE


def test_equal_content_has_one_name_and_any_change_another():
    table, pair = np.arange(6, dtype=np.float32).reshape(2, 3), make_dataclass("Pair", ["first", "second"])
    values = [
        1, 1.0, True, "1", b"1", None, (1,), [[1]], {"a": 1}, {"b": 1}, pair(1, 2), pair(2, 1), pair((1, 2), ()),
        table, table.T, table.reshape(3, 2), table.astype(np.float64), np.nan,
        EncodeSettings(), EncodeSettings(quality=2.0),
    ]  # fmt: skip
    names = [digest(value) for value in values]
    assert len(set(names)) == len(values)
    assert digest(table.T.copy()) == digest(table.T)
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    assert digest((1, 2)) == digest([1, 2]) and digest("ab", "c") != digest("a", "bc")
    for value in (object(), {1, 2}, print, [object()]):  # what has no content
        with pytest.raises(TypeError):
            digest(value)


def imported(path):
    """Names that a module of this package imports for more than types, as its syntax tree has them."""
    body = ast.parse(path.read_text()).body
    run = [node for node in body if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))]
    for node in ast.walk(ast.Module(run, [])):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("module", ["encoder", "trainer"])
def test_the_code_of_a_function_is_all_that_its_module_imports_and_its_own_package_as_well(module):
    found = modules_run(f"airgs_codec.{module}.pipeline")
    for path in found.values():
        for name in imported(path):
            package, *parts = name.split(".")
            stem = PACKAGE.joinpath(*parts)
            if package == "airgs_codec" and (stem.with_suffix(".py").is_file() or (stem / "__init__.py").is_file()):
                assert name in found, f"{path} imports {name}"
    above = ("airgs_codec.play", "airgs_codec.serve", "airgs_codec.inspect", "airgs_codec.cli")
    assert "airgs_codec" in found and not any(name.startswith(above) for name in found)
    assert {"tests.support.jobs", "airgs_codec.jobs.job"} <= modules_run(square.__module__).keys()
    assert code_digest(square) == code_digest(partial(square, 3)) != code_digest(digest)


EDITS = """
from pathlib import Path
from airgs_codec.jobs.job import _digest_of_module

JOBS = {"train": "airgs_codec.trainer.pipeline", "encode": "airgs_codec.encoder.pipeline"}
for edited in ("play/player.py", "encoder/publish.py", "trainer/pipeline.py", "render/cpu.py", "scene/gaussians.py"):
    before = {job: _digest_of_module.__wrapped__(module) for job, module in JOBS.items()}
    with Path("airgs_codec", edited).open("a") as file:
        file.write("# an edit")
    print(edited, *(job for job, module in JOBS.items() if _digest_of_module.__wrapped__(module) != before[job]))
"""


def test_an_edit_renames_the_results_that_it_may_change_and_no_others(tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "airgs_codec", ignore=shutil.ignore_patterns("__pycache__", "page"))
    command = [sys.executable, "-B", "-c", EDITS]
    done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)}, check=True, capture_output=True)
    assert done.stdout.decode().splitlines() == [
        "play/player.py", "encoder/publish.py", "trainer/pipeline.py train", "render/cpu.py train encode",
        "scene/gaussians.py train encode",
    ]  # fmt: skip
