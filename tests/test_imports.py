"""The tree tells the path: folders import only from those before them, and heavy libraries stay where they belong."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter

import pytest

from tests.support.paths import PACKAGE

ROOT = "the root"
ORDER = (
    ROOT, "places", "media", "scene", "package", "coding", "decoder", "render", "jobs", "analysis", "trainer", "play",
    "serve", "encoder", "inspect", "cli",
)  # fmt: skip
MAY_IMPORT = {
    "torch": {
        "render/differentiable.py",
        "render/cuda.py",
        "render/reference.py",
        "trainer",
    },
    "gsplat": {"render/cuda.py"},
    "pycolmap": set(),  # of tests alone
    "gaussforge": {"scene/formats/sandbox.py"},
    "fourdgs": {"scene/formats/sandbox.py"},
    "gsply": {"scene/formats/spz.py"},
    "pygltflib": set(),  # of tests alone
    "av": {"media/h264.py", "media/movie.py", "media/sound.py"},
    "cv2": {"media/image.py"},
    "PIL": {"media/image.py"},
    "colour": {"media/metrics.py"},
    "numba": {
        "cli/kernels.py",
        "coding/rangecoder.py",
        "render/cpu.py",
        "render/cpu_kernels.py",
        "trainer/fit/kernels.py",
    },
    "matplotlib": {"_report.py"},
    "dask": {"jobs/dask_engine.py"},
    "distributed": {"jobs/dask_engine.py"},
    "aiohttp": {"play/http.py"},
    "hypercorn": {"serve/server.py"},
    "obstore": {"places/place.py"},
    "starlette": {"serve/app.py", "serve/server.py"},
}
MODULES = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}


def path_of(name):
    """The key in MODULES of a dotted module of this package, or None."""
    stem = name.removeprefix("airgs_codec.").replace(".", "/")
    return next((key for key in (f"{stem}.py", f"{stem}/__init__.py") if key in MODULES), None)


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if path_of(inner) else node.module


def modules_of(path):
    """Modules of this package that a file imports, as keys of MODULES."""
    return {key for name in imports_of(path) if name.startswith("airgs_codec.") and (key := path_of(name))}


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


def test_no_imports_go_round_in_circles():
    TopologicalSorter({module: set(modules_of(path)) - {module} for module, path in MODULES.items()}).prepare()


@pytest.mark.parametrize("module", MODULES)
def test_heavy_libraries_stay_in_their_module(module):
    for name in imports_of(MODULES[module]):
        library = name.split(".")[0]
        if library in MAY_IMPORT:
            homes = MAY_IMPORT[library]
            assert any(module == home or module.startswith(f"{home}/") for home in homes), f"{module}: {name}"


def test_the_decoder_knows_nothing_of_the_encoder():
    decoder = [path for module, path in MODULES.items() if folder_of(module) == "decoder"]
    assert decoder
    assert not any(folder_of(used) == "encoder" for path in decoder for used in modules_of(path))


TORCHLESS = [
    "decoder.decode",
    "encoder.publish",
    "play.session",
    "inspect.validate",
    *(f"cli.{c}" for c in ("decode", "encode", "play", "train")),
]


def test_torch_is_never_loaded():
    """One process imports all of them and says after which of them torch or colour-science was there."""
    code = f"""
import importlib, sys
for name in {TORCHLESS}:
    importlib.import_module("airgs_codec." + name)
    found = {{"torch", "colour"}} & sys.modules.keys()
    sys.exit(f"{{name}} loads {{found}}") if found else None
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
