"""The public names: each resolves, is documented, is seen by type checkers, and costs nothing until it is used."""

import ast
import inspect
import subprocess
import sys

import pytest

import airgs_codec as airgs
from tests.support.paths import PACKAGE

NAMES = {
    "AirgsError",
    "EncodeSettings",
    "Gaussians",
    "SessionSettings",
    "decode",
    "encode",
    "open_package",
    "open_sequence",
    "open_trace",
    "validate",
}
FUNCTIONS = sorted(name for name in NAMES if name[0].islower())
HEAVY = ("numpy", "numba", "scipy", "torch", "cv2", "av", "colour", "matplotlib", "tqdm")


def test_the_names_are_these():
    assert set(airgs.__all__) == NAMES
    assert sorted(airgs.__all__) == airgs.__all__
    assert set(dir(airgs)) >= NAMES


@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_name_resolves_to_what_is_defined_under_it(name):
    value = getattr(airgs, name)
    assert value.__name__ == name
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


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name.startswith("open_") or name == "validate"])
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
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    assert seen == {name: getattr(airgs, name).__module__ for name in NAMES}
    assert (PACKAGE / "py.typed").is_file()


def test_importing_the_package_loads_nothing_heavy():
    code = f"import sys, airgs_codec; sys.exit(', '.join(n for n in {HEAVY} if n in sys.modules) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"loaded: {done.stderr}"
