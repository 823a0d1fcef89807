"""One browser for all tests of a process."""

import pytest

from tests.support.browser import close_browser


@pytest.fixture(scope="session", autouse=True)
def _browser():
    yield
    close_browser()
