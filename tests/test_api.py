"""The public names: each resolves, is documented, is seen by type checkers, and costs nothing until it is used."""

import ast
import inspect
import pickle
import subprocess
import sys

import numpy as np
import pytest

import airgs_codec as airgs
from tests.faces import summarise
from tests.support.paths import FOX, GOLDEN, PACKAGE
from tests.support.scenes import moving_frames, write_sequence

NAMES = {
    "AirgsError",
    "Camera",
    "Decision",
    "EncodeSettings",
    "Gaussians",
    "Goal",
    "Package",
    "PlayerState",
    "Sequence",
    "SessionSettings",
    "Trace",
    "TrainSettings",
    "compare",
    "decode",
    "decode_frames",
    "draw",
    "encode",
    "input_rows",
    "open_package",
    "open_sequence",
    "read",
    "simulate",
    "train",
    "validate",
    "write",
}
THERE = {"Sequence": "GaussianSequence"}  # names in their modules, where they are others
MOST_NAMES = 25
FUNCTIONS = sorted(name for name in NAMES if name[0].islower())
HEAVY = ("numpy", "numba", "scipy", "torch", "cv2", "av", "colour", "matplotlib", "tqdm")


def test_the_names_are_these():
    assert set(airgs.__all__) == NAMES
    assert len(NAMES) <= MOST_NAMES
    assert sorted(airgs.__all__) == airgs.__all__
    assert set(dir(airgs)) >= NAMES


@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_name_resolves_to_what_is_defined_under_it(name):
    value = getattr(airgs, name)
    assert value.__name__ == THERE.get(name, name)
    assert value.__module__.startswith("airgs_codec.")


@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_name_is_documented(name):
    words = inspect.getdoc(getattr(airgs, name))
    assert words and words[0].isupper()
    assert "\n" in words or name[0].isupper(), "a function says more than one line"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_typed_and_say_what_they_raise(name):
    function = getattr(airgs, name)
    signature = inspect.signature(function)
    assert signature.return_annotation is not signature.empty
    assert all(p.annotation is not p.empty for p in signature.parameters.values())
    assert "aises" in inspect.getdoc(function)


@pytest.mark.parametrize("name", ["open_package", "open_sequence", "read", "validate"])
def test_paths_are_text_or_paths(name):
    first = next(iter(inspect.signature(getattr(airgs, name)).parameters.values()))
    assert first.annotation == "str | Path"


def test_other_names_are_missing():
    with pytest.raises(AttributeError, match="no_such_name"):
        airgs.no_such_name  # noqa: B018
    with pytest.raises(ImportError):
        exec("from airgs_codec import no_such_name")


def test_type_checkers_see_the_same_names_in_the_same_places():
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.asname or alias.name: node.module for node in block.body for alias in node.names}
    assert seen == {name: getattr(airgs, name).__module__ for name in NAMES}
    assert (PACKAGE / "py.typed").is_file()


def test_importing_the_package_loads_nothing_heavy():
    code = f"import sys, airgs_codec; sys.exit(', '.join(n for n in {HEAVY} if n in sys.modules) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"loaded: {done.stderr}"


OTHERS = """
import sys
from multiprocessing import get_context
import airgs_codec as airgs

def drawn(package):
    return airgs.draw(airgs.decode(package, 0), package.cameras[0]).rgb.tobytes()

if __name__ == "__main__":
    package = airgs.open_package(sys.argv[1])
    here = drawn(package)
    for method in ("fork", "spawn", "forkserver"):
        with get_context(method).Pool(1) as pool:
            assert pool.apply(drawn, (package,)) == here, method
"""


def test_other_processes_draw_however_they_are_started_after_this_one_has_drawn(tmp_path):
    (tmp_path / "others.py").write_text(OTHERS)
    command = [sys.executable, str(tmp_path / "others.py"), str(GOLDEN / "fox")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr


def test_a_frame_of_a_loader_is_drawn_in_its_workers():
    data = pytest.importorskip("torch.utils.data")
    sequence = airgs.open_sequence(FOX)
    airgs.draw(sequence[0], sequence.cameras[0])
    loader = data.DataLoader(
        sequence, num_workers=1, collate_fn=lambda g: airgs.draw(g[0], sequence.cameras[0]).rgb.sum(), timeout=60
    )
    assert len(list(loader)) == len(sequence)


@pytest.fixture(scope="module")
def public():
    """One of everything that public functions return."""
    package, sequence = airgs.open_package(GOLDEN / "fox"), airgs.open_sequence(FOX)
    frame = next(airgs.decode_frames(package, 0, 1))
    camera, log = package.cameras[0], airgs.simulate(package, "const:5")
    picture = airgs.draw(frame.gaussians, camera)
    assert picture._repr_png_().startswith(b"\x89PNG")
    compared = airgs.compare(sequence, sequence, frames=range(1))
    things = (package, sequence, frame, camera, log, picture, compared, airgs.Trace.open("markov:1"), sequence[:3])
    return {type(thing).__name__: thing for thing in things}


KINDS = ["Package", "GaussianSequence", "Frame", "Camera", "SessionLog", "Render", "Comparison", "Trace", "LazyFrames"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_returned_can_be_pickled_and_is_shown_in_a_line(public, kind):
    thing = public[kind]
    copy = pickle.loads(pickle.dumps(thing))
    assert repr(copy) == repr(thing) and len(repr(thing)) < 300 and "array(" not in repr(thing)
    if kind == "Package":
        assert (airgs.decode(copy, 3).means == airgs.decode(thing, 3).means).all()
    if kind == "SessionLog":
        assert copy.metrics == thing.metrics and copy.events == thing.events


def test_the_rungs_of_a_package_have_names_bytes_and_psnr(public):
    package = public["Package"]
    rungs, summary = package.rungs, summarise(package.manifest, package.manifest_bytes).rungs
    assert [rung.name for rung in rungs] == ["Q0+L0", "Q0+L1", "Q1+L0", "Q1+L1"]
    assert [(r.bytes, r.psnr, r.best) for r in rungs] == [
        (round(r.bytes_per_frame * package.manifest.frames), r.psnr, r.best) for r in summary
    ]


def test_a_sequence_is_like_a_list(public):
    sequence = public["GaussianSequence"]
    firsts = [g.means[0, 0] for g in sequence]
    assert firsts == [sequence.read(n).means[0, 0] for n in range(len(sequence))]
    assert sequence[-1].means[0, 0] == firsts[-1] and sequence[np.int64(2)].means[0, 0] == firsts[2]
    assert [g.means[0, 0] for g in sequence[7:2:-2]] == firsts[7:2:-2]


def test_a_sequence_is_encoded_with_its_attribution_and_decoded_by_names_or_numbers(tmp_path):
    scene = write_sequence(tmp_path / "scene", moving_frames(60, 2))
    (scene / "ATTRIBUTION.txt").write_text("points by nobody\n")
    settings = airgs.EncodeSettings(calibrate="none", measure_pictures=0, preset="ultrafast")
    airgs.encode(airgs.open_sequence(str(scene)), str(tmp_path / "scene.airgs"), settings)
    package = airgs.open_package(str(tmp_path / "scene.airgs"))
    assert package.manifest.attribution == "points by nobody"
    assert airgs.validate(str(package.files.path)) == []
    by_name, by_number = (airgs.decode(package, 1, level=j, key_quality=q) for j, q in (("L2", "Q1"), (2, 1)))
    assert isinstance(by_name, airgs.Gaussians)
    assert (by_name.means == by_number.means).all()


WITHOUT_EXTRAS = """
import sys
for name in ("torch", "gsplat", "matplotlib"):
    sys.modules[name] = None  # an import of it fails as where it is not installed
from airgs_codec.cli import decode, encode, manifest, play, train
options = ["--calibrate", "none", "--measure-pictures", "2", "--x264-preset", "ultrafast"]
assert encode.main(["scene", "-o", "scene.airgs", *options]) == 0
assert decode.main(["scene.airgs", "-o", "decoded"]) == 0
assert manifest.main(["validate", "scene.airgs", "--against", "scene"]) == 0
assert manifest.main(["inspect", "scene.airgs"]) == 0
assert play.main(["scene.airgs", "--trace", "const:5"]) == 0
assert play.main(["scene.airgs", "--trace", "const:5", "--report", "report"]) == 2
assert manifest.main(["inspect", "scene.airgs", "--plot", "plot.png"]) == 2
assert train.main(["scene", "-o", "model"]) == 2
"""


def test_all_but_training_and_pictures_works_without_the_extras(tmp_path):
    write_sequence(tmp_path / "scene", moving_frames(300, 3))
    command = [sys.executable, "-c", WITHOUT_EXTRAS]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stderr.splitlines() if "pip install" in line]
    assert [("plot" in line, "train" in line) for line in said] == [(True, False), (True, False), (False, True)]
