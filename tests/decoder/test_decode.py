"""The public way in: one frame of a package, level and keyframe quality by id or by index."""

import itertools
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.coding import atlas, kernels, rangecoder
from tests import faces
from tests.faces import ConfigError, decode, decode_canonical, decode_frames, open_package
from tests.support.paths import GOLDEN, VALID

CASES = sorted(path.stem for path in GOLDEN.glob("*.json"))
WAYS = (lambda *_: None), (lambda loop, _: rangecoder._compiled(loop))  # loops as they stand, compiled
ROOM = open_package(GOLDEN / "room")


@pytest.fixture(scope="module")
def package():
    return open_package(str(VALID / "moving"))


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in a.__slots__)


@pytest.mark.parametrize("level", ["L1", 1, "1"])
def test_a_frame_is_that_of_the_sequence_however_its_rung_is_named(package, level):
    frames = [f.gaussians for f in decode_frames(package, 0, 4, level=1, keyframe_quality=1)]
    assert same(decode(package, 2, level=level, keyframe_quality="Q1"), frames[2])
    assert not same(decode(package, 2), frames[2])


@pytest.mark.parametrize("places", [[], [0], [3], [1, 3], [0, 2, 3], range(1, 3)])
@pytest.mark.parametrize("level", [0, 1])
def test_some_frames_of_a_segment_are_those_of_the_whole(package, level, places):
    base = decode_canonical(package, 0, 0)
    whole, some = (list(faces.decode_segment(package, 0, base, level, frames)) for frames in (range(4), places))
    assert len(some) == len(places) and all(same(whole[i], g) for i, g in zip(places, some, strict=True))


@pytest.mark.parametrize(("read", "choice", "message"), [
    *((decode, {"level": n}, f"level: expected one of L0, L1, got {n!r}") for n in ("L9", -1, "Q0")),
    (decode, {"keyframe_quality": 2}, "keyframe_quality: expected one of Q0, Q1, got 2"),
    *((decode, {"frame": n}, f"frame: expected 0..3, got {n}") for n in (4, -1)),
    *((decode_frames, {"start": a, "stop": b}, f"frames: expected a range inside 0:4, got {a}:{b}")
      for a, b in ((0, 5), (-1, 2), (3, 2))),
    *((decode_frames, {"start": 0, "stop": 1, "tiers": n}, f"tiers: expected 1..2, got {n}") for n in (-1, 0, 3)),
])  # fmt: skip
def test_what_the_package_does_not_have_is_refused_in_one_line(package, read, choice, message):
    with pytest.raises(ConfigError) as refused:
        decode(package, **({"frame": 0} | choice)) if read is decode else next(read(package, **choice))
    assert str(refused.value) == message


def test_a_tier_without_rows_decodes_to_none():
    m, groups = ROOM.manifest, []
    for group in m.groups:
        first, second = group.tiers
        first = replace(first, count=0, sidecar=faces.NO_FILE, pictures=[faces.NO_FILE] * len(first.pictures))
        groups.append(replace(group, count=second.count, tiers=[first, second]))
    emptied = faces.Package(ROOM.files, replace(m, groups=faces.Groups.of(groups)), 0)
    assert [len(frame.gaussians) for frame in decode_frames(emptied, 0, m.frames, tiers=1)] == [0] * m.frames
    both, second = decode_canonical(emptied, 0, 0, 2), decode_canonical(ROOM, 0, 0)
    assert both.means.tolist() == second.means[m.groups[0].tiers[0].count :].tolist()


@pytest.mark.parametrize("level", [0, 1])
def test_how_many_rows_are_decoded_together_changes_nothing(monkeypatch, level):
    package, frames = open_package(GOLDEN / "fox"), []
    for most in (256, 1 << 24):
        monkeypatch.setattr(kernels, "CHUNK", 1)
        monkeypatch.setattr(kernels, "LEAST", most)
        frames.append([frame.gaussians for frame in decode_frames(package, 0, 4, level=level)])
    assert len(frames[0][0]) > 2 * 256
    assert all(same(a, b) for a, b in zip(*frames, strict=True))


@pytest.mark.parametrize("case", CASES)
def test_compiled_loops_decode_to_the_bits_of_plain_ones(monkeypatch, case):
    package, frames = open_package(GOLDEN / case), []
    for way, module in itertools.product(WAYS, (atlas, kernels)):
        monkeypatch.setattr(module, "worth_compiling", way)
        frames.append([frame.gaussians for frame in decode_frames(package, 0, package.manifest.frames)])
    assert all(same(a, b) for some in frames for a, b in zip(frames[0], some, strict=True))


def test_compiled_rotations_by_any_angle_are_those_of_plain_ones(monkeypatch):
    rng, turned = np.random.default_rng(0), np.empty((2, 999, 4), np.float32)
    vectors = (rng.normal(size=(3, 999)) * 10.0 ** rng.uniform(-12, 2, 999)).astype(np.float32)
    for out, way in zip(turned, WAYS, strict=True):
        monkeypatch.setattr(kernels, "worth_compiling", way)
        kernels.change_rows(out, np.arange(999), np.eye(4, dtype=np.float32)[np.arange(999) % 4], vectors)
    np.testing.assert_allclose(turned[1], turned[0], rtol=0, atol=1e-6)


BARE = """
import json, sys

class Refuses:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in sys.argv[1].split():
            raise ModuleNotFoundError(f"refused: {name}", name=name)

sys.meta_path.insert(0, Refuses())
import airgs_codec
packages = [airgs_codec.open_package(path) for path in sys.argv[2:]]
airgs_codec.decode(packages[0], packages[0].manifest.frames - 1, level="L1", keyframe_quality="Q1")
modules = [name for name in sys.modules if name.split(".")[0] == "airgs_codec"]
from tests.support.digests import digests
print(json.dumps([modules, [digests(package) for package in packages]]))
"""
REFUSED = "numba scipy torch colour cv2 PIL matplotlib aiohttp hypercorn starlette tqdm obstore"


def test_the_goldens_decode_to_the_recorded_codes_with_few_modules_and_no_library_but_numpy_and_av():
    recorded = [json.loads((GOLDEN / f"{case}.json").read_text()) for case in CASES]
    assert len(CASES) >= 3 and min(map(len, recorded)) > 10 and CASES[0] == "fox"
    command = [sys.executable, "-c", BARE, REFUSED, *(str(GOLDEN / case) for case in CASES)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    modules, found = json.loads(done.stdout)
    assert found == recorded and len(modules) <= 36, modules
    folders = {name.split(".")[1] for name in modules if "." in name}
    assert not folders & {"render", "analysis", "encoder", "trainer", "play", "jobs", "inspect", "cli"}
    shown = next(faces.decode_pictures(open_package(GOLDEN / "fox-fine"), 0, 0, range(1)))  # there are escapes
    assert any(base is not None and base.any() for base in shown.luma[1])


@pytest.mark.parametrize(("case", "asked"), [
    ("fox", [(0, 0, 0), (0, 0, 0), (-1, 0, 0), (-1, 0, 1), (0, 0, 1), (0, 0, 0)]),
    ("room", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (3, 0, 0), (1, 0, 0)]),
])  # fmt: skip
def test_a_frame_is_that_of_a_fresh_package_whatever_was_decoded_before(case, asked):
    """`asked`: frame, level and keyframe quality. Frames may be written to."""

    def shown(package, frame, level, quality):
        return decode(package, frame % package.manifest.frames, level=level, keyframe_quality=quality)

    fresh = [shown(open_package(GOLDEN / case), *which) for which in asked]
    package = open_package(GOLDEN / case)
    for which, expected in zip(asked, fresh, strict=True):
        got = shown(package, *which)
        assert same(got, expected)
        for name in got.__slots__:
            getattr(got, name)[:] = np.nan
