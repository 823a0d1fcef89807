"""The tree tells the path: folders import only from those before them, and heavy libraries stay where they belong."""

import ast
from functools import cache
from graphlib import TopologicalSorter

import pytest

from tests.support.house import nodes
from tests.support.paths import PACKAGE, REPOSITORY

ROOT = "the root"
ORDER = (  # the decoder knows nothing of the encoder
    ROOT, "places", "media", "scene", "package", "coding", "decoder", "render", "jobs", "analysis", "trainer", "play",
    "serve", "encoder", "inspect", "cli",
)  # fmt: skip
MAY_IMPORT = {  # libraries: their modules, none for those of tests alone
    "torch": {"render/cuda.py", "render/reference.py", "trainer"}, "aiohttp": {"play/http.py"},
    "numba": {
        "coding/rangecoder.py", "render/cpu.py", "render/cpu_kernels.py", "trainer/fit/kernels.py",
    },
    "av": {"media/h264.py", "media/movie.py"}, "starlette": {"serve/app.py"}, "hypercorn": {"serve/app.py"},
    "cv2": {"media/image.py"}, "PIL": {"media/image.py"}, "colour": {"media/metrics.py"}, "matplotlib": {"_report.py"},
    "gaussforge": {"scene/formats/sandbox.py"}, "fourdgs": {"scene/formats/sandbox.py"},
    "gsply": {"scene/formats/packed.py"}, "gsplat": {"render/cuda.py"}, "pycolmap": set(), "pygltflib": set(),
    "dask": {"jobs/executors.py"}, "distributed": {"jobs/executors.py"}, "obstore": {"places/place.py"},
}  # fmt: skip
MODULES = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}


def path_of(name):
    """The key in MODULES of a dotted module of this package, or None."""
    stem = name.removeprefix("airgs_codec.").replace(".", "/")
    return next((key for key in (f"{stem}.py", f"{stem}/__init__.py") if key in MODULES), None)


@cache
def imports_of(path):
    """Dotted names of what a file imports: modules, or names in modules that are none."""
    found = []
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


@cache
def modules_of(path):
    """Modules of this package that a file imports, as keys of MODULES."""
    names = [name for name in imports_of(path) if name.startswith("airgs_codec.")]
    return {key for name in names if (key := path_of(name) or path_of(name.rpartition(".")[0]))}


def folder_of(module):
    return module.split("/")[0] if "/" in module else ROOT


def test_every_folder_has_its_place_in_the_order_and_the_root_is_small():
    assert {folder_of(module) for module in MODULES} == set(ORDER)
    assert len([module for module in MODULES if folder_of(module) == ROOT]) <= 8


@pytest.mark.parametrize("folder", ORDER)
def test_a_folder_imports_only_from_those_before_it(folder):
    for module, path in MODULES.items():
        if folder_of(module) == folder and module != "__init__.py":  # the root's is the API: it may name everything
            upward = {used for used in modules_of(path) if ORDER.index(folder_of(used)) > ORDER.index(folder)}
            assert not upward, f"{module} imports {sorted(upward)}"


def test_no_imports_go_round_in_circles_and_heavy_libraries_stay_in_their_module():
    TopologicalSorter({module: modules_of(path) - {module} for module, path in MODULES.items()}).prepare()
    for module, path in MODULES.items():
        for name in imports_of(path):
            homes = MAY_IMPORT.get(name.split(".")[0], {module})
            assert any(module == home or module.startswith(f"{home}/") for home in homes), f"{module}: {name}"


def test_imports_go_one_way_and_nothing_private_is_imported_from_another_folder():
    """tests -> tools -> airgs_codec. Modules of the root whose names begin with an underscore are shared by all."""
    for folder, never in (("airgs_codec", {"tools", "tests"}), ("tools", {"tests"})):
        for path in (REPOSITORY / folder).rglob("*.py"):
            assert not never & {name.split(".")[0] for name in imports_of(path)}, path
    for path in MODULES.values():
        deep = [name.split(".") for name in imports_of(path) if name.startswith("airgs_codec.") and name.count(".") > 2]
        private = [".".join(parts) for parts in deep if any(part.startswith("_") for part in parts[2:])]
        assert all(name.split(".")[1] == path.parent.name for name in private), f"{path}: {private}"
