"""Heavy libraries stay where they belong, and imports go down only."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "airgs_codec"
MAY_IMPORT = {
    "torch": {"render/autograd.py", "render/cuda.py", "render/reference.py", "train"},
    "gsplat": {"render/cuda.py"},
    "pycolmap": {"train/colmap.py"},
    "av": {"video.py"},
    "cv2": {"picture.py"},
    "colour": {"color.py"},
    "numba": {"rangecoder.py", "render/cpu.py", "render/cpu_kernels.py", "train/loss_kernels.py"},
    "plyfile": {"ply.py"},
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.relative_to(PACKAGE).as_posix())
def test_heavy_libraries_stay_in_their_module(path):
    name = path.relative_to(PACKAGE).as_posix()
    for module in imports_of(path):
        library = module.split(".")[0]
        if library in MAY_IMPORT:
            assert any(name == home or name.startswith(f"{home}/") for home in MAY_IMPORT[library]), f"{name}: {module}"


def test_encode_and_decode_do_not_import_each_other_and_nothing_below_imports_commands():
    for path in MODULES:
        names = set(imports_of(path))
        relative = path.relative_to(PACKAGE).as_posix()
        if relative in ("encode.py", "plan.py"):
            assert "airgs_codec.decode" not in names
        if relative == "decode.py":
            assert not names & {"airgs_codec.encode", "airgs_codec.plan", "airgs_codec.settings"}
        if not relative.startswith("cli/"):
            assert not any(name.startswith("airgs_codec.cli") for name in names), relative
        if not relative.startswith(("cli/", "play/")):
            assert not any(name.startswith("airgs_codec.play") for name in names), relative


@pytest.mark.parametrize("module", ["decode", "encode", "play.session", "cli.decode", "cli.play", "cli.encode"])
def test_torch_is_never_loaded(module):
    code = f"import sys, airgs_codec.{module}; sys.exit('torch' in sys.modules or 'colour' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
