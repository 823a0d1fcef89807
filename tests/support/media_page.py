"""The page that tries the player's media part (web/test/pages/media.ts), from Python."""

import json
from collections.abc import Mapping
from typing import Any

from tests.support.browser import WEB, build_pages, serve, visit
from tests.support.paths import GOLDEN, VALID

PAGE = b'<!doctype html><meta charset="utf-8"><script type="module" src="/web/out/pages/media.js"></script>'
FOLDERS = {"golden": GOLDEN, "valid": VALID}


def look(
    steps: Mapping[str, tuple[str, dict[str, Any]]],
    made: Mapping[str, Any] | None = None,
    folders: Mapping[str, Any] | None = None,
) -> tuple[Any, Any]:
    """What a page reports of steps, name -> (task, arguments); Chromium may say what it thinks of faults."""
    build_pages()
    plan = [{"name": name, "task": task} | arguments for name, (task, arguments) in steps.items()]
    pages = {"/page.html": lambda: PAGE, "/plan.json": lambda: json.dumps(plan).encode()}
    with serve(FOLDERS | {"web": WEB} | dict(folders or {}), pages | dict(made or {})) as site:
        seen = visit(f"{site.url}/page.html")
    assert [line for line in seen.failed if "net::" not in line] == []
    assert seen.report.keys() == steps.keys()
    return seen.report, site.answers
