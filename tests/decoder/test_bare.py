"""Packages are decoded with numpy, PyAV and few of our modules: what draws, measures, encodes and serves stays out."""

import json
import subprocess
import sys

import numpy as np
import pytest

import airgs_codec
from airgs_codec.coding import escapes
from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.media.h264 import open_segment
from airgs_codec.package.package import open_package
from tests.support.paths import GOLDEN

REFUSED = (
    "numba", "scipy", "torch", "colour", "cv2", "PIL", "matplotlib", "aiohttp", "hypercorn", "starlette", "tqdm",
    "obstore",
)  # fmt: skip
BARE = f"""
import sys

class Refuses:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {REFUSED}:
            raise ModuleNotFoundError(f"refused: {{name}}", name=name)

sys.meta_path.insert(0, Refuses())
"""
DECODES = """
import airgs_codec, json
package = airgs_codec.open_package(sys.argv[1])
last = package.manifest.frames - 1
airgs_codec.decode(package, last, level="L1", key_quality="Q1")
print(json.dumps([name for name in sys.modules if name.split(".")[0] == "airgs_codec"]))
"""


def run_bare(code, *arguments):
    done = subprocess.run([sys.executable, "-c", BARE + code, *arguments], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_decoding_loads_few_modules_and_no_library_but_numpy_and_av():
    modules = json.loads(run_bare(DECODES, str(GOLDEN / "fox")))
    folders = {name.split(".")[1] for name in modules if "." in name}
    assert len(modules) <= 35, modules
    assert not folders & {"render", "analysis", "encoder", "train", "play", "jobs", "inspect", "cli"}


@pytest.mark.parametrize("case", sorted(path.stem for path in GOLDEN.glob("*.json")))
def test_the_goldens_decode_to_the_recorded_codes_without_those_libraries(case):
    code = "import json, sys\nfrom tests.support.digests import digests\n"
    code += (
        "from airgs_codec.package.package import open_package\nprint(json.dumps(digests(open_package(sys.argv[1]))))"
    )
    recorded = json.loads((GOLDEN / f"{case}.json").read_text())
    assert len(recorded) > 10 and json.loads(run_bare(code, str(GOLDEN / case))) == recorded


def test_the_goldens_have_escapes():
    columns, _ = open_segment(open_package(GOLDEN / "fox-fine").read("state/L0/1.m4s"), "x")
    assert ColumnReader(columns, "x").column(1, 0)[0] > 0


def test_importing_the_package_loads_nothing():
    assert run_bare("import airgs_codec; print(sorted({'numpy', 'av'} & sys.modules.keys()))").strip() == "[]"


@pytest.mark.parametrize(
    ("case", "asked", "segments"),
    [
        ("fox", [(0, 0, 0), (0, 0, 0), (-1, 0, 0), (-1, 0, 1), (0, 0, 1), (0, 0, 0)], None),
        # A segment has two frames: its escapes are read whenever the segment or the level changes.
        ("room", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (3, 0, 0), (1, 0, 0)], [(0, 0), (0, 1), (1, 0), (0, 0)]),
    ],
)
def test_a_frame_is_that_of_a_fresh_package_whatever_was_decoded_before(monkeypatch, case, asked, segments):
    """`asked`: frame, level and key quality. Frames may be written to, and escapes are read as seldom as can be."""

    def decode(package, frame, level, quality):
        return airgs_codec.decode(package, frame % package.manifest.frames, level=level, key_quality=quality)

    fresh = [decode(open_package(GOLDEN / case), *which) for which in asked]
    package, read, unpack = open_package(GOLDEN / case), [], escapes.unpack_segment
    monkeypatch.setattr(escapes, "unpack_segment", lambda *arguments: read.append(arguments[-1]) or unpack(*arguments))
    for which, expected in zip(asked, fresh, strict=True):
        got = decode(package, *which)
        for name in got.__slots__:
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
            getattr(got, name)[:] = np.nan
    if segments:
        assert read == [file for which in segments for file in package.manifest.state_files(*which)]
