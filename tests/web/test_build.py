"""The player that is committed, and that a wheel brings along, is what the sources build, and small."""

import gzip
import subprocess
import tomllib

import pytest

from airgs_codec.serve.pages import PAGE, PAGE_TYPES, is_built
from tests.support.browser import WEB, missing
from tests.support.paths import PACKAGE, REPOSITORY

MOST_BYTES = {
    "airgs.js": 46_200,
    "airgs-frames.js": 23_500,
    "airgs-player.js": 58_100,
    "airgs-vr.js": 2_000,
    "airgs-more.js": 15_700,
    "airgs-sound.js": 3_700,
}  # as gzip
LACKING = [what for what in missing() if what != "chromium"]


def test_the_player_is_in_the_package():
    assert is_built() and {path.name for path in PAGE.iterdir()} == set(PAGE_TYPES)


@pytest.mark.skipif(bool(LACKING), reason=f"lacks {', '.join(LACKING)}")
def test_it_is_what_the_sources_build(tmp_path):
    command = ["node", str(WEB / "scripts" / "main.mjs"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    old = [path.name for path in tmp_path.iterdir() if path.read_bytes() != (PAGE / path.name).read_bytes()]
    assert not old, f"{', '.join(sorted(old))}: older than web/src; run make page and commit"


@pytest.mark.parametrize("name", MOST_BYTES)
def test_it_is_small(name):
    assert len(gzip.compress((PAGE / name).read_bytes())) <= MOST_BYTES[name]


def test_a_wheel_brings_it_along():
    """setuptools takes what these patterns match."""
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["setuptools"]
    packed = {path for pattern in settings["package-data"]["airgs_codec"] for path in PACKAGE.glob(pattern)}
    assert {PAGE / name for name in PAGE_TYPES} <= packed
