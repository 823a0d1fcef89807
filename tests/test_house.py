"""The house keeps its measures: short functions, few parameters, short modules, and tools that know no tests."""

import ast
import statistics

import pytest

from tests.support.house import FOLDERS, House, measure, percentile
from tests.support.paths import REPOSITORY


@pytest.mark.parametrize("folder", FOLDERS)
def test_nothing_is_over_a_hard_limit(folder):
    assert measure(REPOSITORY / folder).excesses() == []


def test_most_of_the_package_is_much_shorter():
    columns = measure(REPOSITORY / "airgs_codec").columns()
    modules, bodies, parameters = (columns[name] for name in ("module lines", "body lines", "parameters"))
    assert len(modules) > 100 and len(bodies) > 800
    assert statistics.median(modules) <= 160  # modules under 40 lines join the one that imports them
    assert statistics.median(bodies) <= 6 and percentile(bodies, 0.9) <= 16
    assert percentile(parameters, 0.9) <= 4


@pytest.mark.parametrize(("folder", "never"), [("airgs_codec", {"tools", "tests"}), ("tools", {"tests"})])
def test_imports_go_one_way(folder, never):
    """tests -> tools -> airgs_codec."""
    for path in (REPOSITORY / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [getattr(node, "module", None)]
            assert not never & {(name or "").split(".")[0] for name in names}, path


SOURCE = '''"""A module."""
from numba import njit
import numba as nb


def short(a, /, b, *rest, c=1, **more):
    """Whole
    sentences do not count."""
    # a comment does not, before the first statement
    d = a

    return d


class Thing:
    def method(self, a):
        def inner(x): return x
        return inner(a)

    @classmethod
    def made(cls): """Nothing but words."""


@njit(cache=True)
def kernel(a, b, c, d, e, f, g): return a


@nb.njit
def other(a, b, c, d, e, f, g): return a
'''


def test_what_is_counted(tmp_path):
    (tmp_path / "thing.py").write_text(SOURCE)
    (tmp_path / "__init__.py").touch()
    house = measure(tmp_path)
    assert list(house.modules.values()) == [len(SOURCE.splitlines())]
    sizes = {f.where.split()[-1]: (f.body, f.parameters) for f in house.functions}
    assert sizes == {"short": (3, 5), "method": (2, 1), "inner": (1, 1), "made": (0, 0)}


def test_what_is_over_a_limit_is_named(tmp_path):
    body = "\n".join(f"    x = {i}" for i in range(61))
    (tmp_path / "long.py").write_text(f"def long(a, b, c, d, e, f, g):\n{body}\n" + "\n" * 300)
    excesses = measure(tmp_path).excesses()
    assert len(excesses) == 3 and any(line.endswith("long.py:1 long: 61 lines, at most 60") for line in excesses)


def test_nothing_is_over_no_limit():
    assert House({}, ()).excesses() == []
    assert percentile([], 0.9) == 0 and percentile([1, 2, 3, 4, 5, 6, 7, 8, 9, 10], 0.9) == 9
