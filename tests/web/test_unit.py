"""The parts of the browser player that need no browser, by Node's own test runner, and what its checkers say."""

from __future__ import annotations

import subprocess

import pytest

from tests.support.browser import WEB, missing

WANTED = [what for what in missing() if what != "chromium"]
pytestmark = pytest.mark.skipif(bool(WANTED), reason=f"not here: {', '.join(WANTED)}")


def test_unit_tests_pass() -> None:
    done = subprocess.run(
        ["node", "scripts/unit.mjs"], cwd=WEB, capture_output=True, text=True, encoding="utf-8", timeout=600
    )
    failed = [line for line in done.stdout.splitlines() if line.lstrip().startswith("not ok")]
    assert done.returncode == 0, "\n".join([*failed, done.stderr[-2000:]])


def test_types_and_lint_are_clean() -> None:
    done = subprocess.run(
        ["npm", "run", "--silent", "check"], cwd=WEB, capture_output=True, text=True, encoding="utf-8", timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
