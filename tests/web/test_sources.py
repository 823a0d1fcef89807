"""The tree of web/src tells the path: imports go back in the order of folders, never against it nor in circles."""

import re
from graphlib import TopologicalSorter

import pytest

from tests.support.browser import WEB

SOURCES = WEB / "src"
ROOT = "the root"
ORDER = ("generated", "format", "media", "render", "play", "ui", ROOT)
BESIDE = {("render", "media")}  # pairs that know nothing of each other
IMPORT = re.compile(r'\b(?:from|import) "(?:worker:)?(\.[^"]+\.ts)"')
MODULES = {
    path.relative_to(SOURCES).as_posix(): path for path in sorted(SOURCES.rglob("*.ts")) if path.suffixes == [".ts"]
}


def modules_of(module):
    """Modules that one imports, types as well as values, as keys of MODULES."""
    path = MODULES[module]
    found = {(path.parent / name).resolve() for name in IMPORT.findall(path.read_text(encoding="utf-8"))}
    return {name.relative_to(SOURCES).as_posix() for name in found}


def folder_of(module):
    return module.split("/")[0] if "/" in module else ROOT


def test_every_folder_has_its_place_in_the_order_and_every_import_leads_to_a_module():
    assert {folder_of(module) for module in MODULES} == set(ORDER)
    used = {module: modules_of(module) for module in MODULES}
    assert set().union(*used.values()) <= set(MODULES)
    assert used["play/player.ts"] >= {"play/playback.ts", "format/region.ts", "generated/constants.ts"}
    assert "media/worker.ts" in used["media/client.ts"] and "play/player.ts" in used["airgs.ts"]


@pytest.mark.parametrize("folder", ORDER)
def test_a_folder_imports_only_from_those_before_it(folder):
    for module in MODULES:
        if folder_of(module) == folder:
            used = {folder_of(other) for other in modules_of(module)}
            assert not {other for other in used if ORDER.index(other) > ORDER.index(folder)}, module
            assert not {other for other in used if (folder, other) in BESIDE}, module


def test_no_imports_go_round_in_circles():
    TopologicalSorter({module: modules_of(module) for module in MODULES}).prepare()
