"""The sources of the browser player: their checks and unit tests, their order, their builds, and what npm installs."""

import gzip
import json
import re
import subprocess
import tomllib
from graphlib import TopologicalSorter

import pytest

from airgs_codec import __version__
from tests.faces import PAGE_TYPES, is_built
from tests.support.browser import WEB, build_pages, missing
from tests.support.page import SHIPPED
from tests.support.paths import PACKAGE, REPOSITORY

SOURCES = WEB / "src"
ROOT = "the root"
ORDER = ("generated", "format", "media", "render", "play", "ui", ROOT)
BESIDE = {("render", "media")}  # pairs that know nothing of each other
IMPORT = re.compile(r'\b(?:from|import) "(?:worker:)?(\.[^"]+\.ts)"')
MODULES = {path.relative_to(SOURCES).as_posix(): path for path in SOURCES.rglob("*.ts") if path.suffixes == [".ts"]}
MOST_BYTES = {  # as gzip
    "airgs.js": 46_200, "airgs-frames.js": 23_500, "airgs-player.js": 58_800, "airgs-vr.js": 2_000,
    "airgs-more.js": 17_000, "airgs-sound.js": 3_700, "airgs-list.js": 1_100,
}  # fmt: skip
PERMISSIVE = {"0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "ISC", "MIT", "PSF-2.0", "Python-2.0"}
LOCK = json.loads((WEB / "package-lock.json").read_text())["packages"]
LACKING = [what for what in missing() if what != "chromium"]

in_node = pytest.mark.skipif(bool(LACKING), reason=f"not here: {', '.join(LACKING)}")


def run(*command):
    done = subprocess.run(command, cwd=WEB, capture_output=True, text=True, encoding="utf-8", timeout=600, check=False)
    failed = [line for line in done.stdout.splitlines() if line.lstrip().startswith("not ok")]
    assert done.returncode == 0, "\n".join([*(failed or [done.stdout]), done.stderr[-2000:]])


@in_node
def test_unit_tests_pass():
    run("node", "scripts/unit.mjs")


# The tree of web/src tells the path: imports go back in the order of folders, never against it nor in circles.


def modules_of(module):
    """Modules that one imports, types as well as values, as keys of MODULES."""
    names = IMPORT.findall(MODULES[module].read_text(encoding="utf-8"))
    return {(MODULES[module].parent / name).resolve().relative_to(SOURCES).as_posix() for name in names}


def folder_of(module):
    return module.split("/")[0] if "/" in module else ROOT


def test_every_folder_has_its_place_in_the_order_and_every_import_leads_to_a_module():
    assert {folder_of(module) for module in MODULES} == set(ORDER)
    used = {module: modules_of(module) for module in MODULES}
    assert set().union(*used.values()) <= set(MODULES)
    assert used["play/player.ts"] >= {"play/playback.ts", "format/region.ts", "generated/constants.ts"}
    assert "media/worker.ts" in used["media/client.ts"] and "play/player.ts" in used["airgs.ts"]
    TopologicalSorter(used).prepare()  # raises where imports go round in circles


@pytest.mark.parametrize("folder", ORDER)
def test_a_folder_imports_only_from_those_before_it(folder):
    for module in (module for module in MODULES if folder_of(module) == folder):
        used = {folder_of(other) for other in modules_of(module)}
        assert not {other for other in used if ORDER.index(other) > ORDER.index(folder)}, module
        assert not {other for other in used if (folder, other) in BESIDE}, module


# The player that is committed is what the sources build, and small, and a wheel brings it along.


@in_node
def test_the_player_is_what_the_sources_build(tmp_path):
    run("node", "scripts/main.mjs", str(tmp_path))
    old = [path.name for path in tmp_path.iterdir() if path.read_bytes() != (SHIPPED / path.name).read_bytes()]
    assert not old, f"{', '.join(sorted(old))}: older than web/src; run make page and commit"


@pytest.mark.parametrize("name", MOST_BYTES)
def test_it_is_small(name):
    assert len(gzip.compress((SHIPPED / name).read_bytes())) <= MOST_BYTES[name]


@in_node
def test_npm_packs_an_element_that_is_small():
    build_pages("examples")
    packed = WEB / "out/project/node_modules/airgs-player"
    assert {path.name for path in packed.iterdir()} == {"LICENSE", "README.md", "dist", "package.json"}
    others = ("airgs-frames", "airgs-more", "playcanvas", "sound", "spark", "three", "vr")
    scripts = [path for path in (packed / "dist").glob("*.js") if not path.name.startswith(others)]
    assert 60_000 < sum(len(gzip.compress(path.read_bytes())) for path in scripts) <= 78_000


def test_a_wheel_brings_it_along():
    """setuptools takes what these patterns match."""
    assert is_built() and {path.name for path in SHIPPED.iterdir()} == set(PAGE_TYPES)
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["setuptools"]
    packed = {path for pattern in settings["package-data"]["airgs_codec"] for path in PACKAGE.glob(pattern)}
    assert {SHIPPED / name for name in PAGE_TYPES} <= packed


# What npm installs for the tests in a browser is pinned, and free for all uses.


def test_versions_are_exact_and_licences_permissive():
    package = json.loads((WEB / "package.json").read_text())
    assert package["version"] == __version__ and "dependencies" not in package
    versions = package["devDependencies"]
    assert versions == LOCK[""]["devDependencies"]
    assert versions == {name: LOCK[f"node_modules/{name}"]["version"] for name in versions}
    packages = [entry for path, entry in LOCK.items() if path]
    choices = [set(entry["license"].strip("()").split(" OR ")) for entry in packages]
    assert choices and all(choice & PERMISSIVE for choice in choices)
    assert all(entry["integrity"].startswith("sha512-") and entry["dev"] for entry in packages)
