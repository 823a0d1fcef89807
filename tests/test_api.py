"""The public names: each resolves, is documented, is seen by type checkers, and costs nothing until it is used."""

import ast
import inspect
import subprocess
import sys

import pytest

import airgs_codec as airgs
from tests.support.paths import PACKAGE
from tests.support.scenes import moving_frames, write_sequence

NAMES = {
    "AirgsError",
    "Camera",
    "Decision",
    "EncodeSettings",
    "Gaussians",
    "Sequence",
    "SessionSettings",
    "Trace",
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
MOST_NAMES = 21
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
