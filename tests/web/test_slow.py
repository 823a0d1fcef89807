"""A screen that is too slow is given less to draw, and the panel says why (web/test/pages/slow.ts)."""

from urllib.parse import urlencode

import pytest

from tests.faces import open_package
from tests.support.browser import WEB, build_pages, missing, serve, visit
from tests.support.paths import GOLDEN
from tests.support.repeated import write_repeated

PAGE = (
    b'<!doctype html><link rel="icon" href="data:,"><body><script type="module" src="/web/out/pages/slow.js"></script>'
)
FPS = 8  # two frames a segment
BUSY_MS = 180  # a picture: of two frames, one has time; where pages are busier still, their decoder waits for them too

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


def test_frames_that_are_dropped_lower_the_level_unless_the_viewer_has_chosen_one(tmp_path):
    build_pages()
    package = write_repeated(open_package(GOLDEN / "fox"), tmp_path / "fox.airgs", 30, FPS)
    with serve({"web": WEB, "package": package}, {"/page.html": lambda: PAGE}) as site:
        seen = visit(f"{site.url}/page.html?{urlencode({'src': '/package/', 'busy': BUSY_MS})}")
    assert seen.complaints() == []
    first, held, chosen = (seen.report[name] for name in ("first", "held", "chosen"))
    assert first == "Q0+L0" and held["rung"].endswith("+L1")  # of whichever keys are there by then
    assert held["stats"]["held"] == {"rung": 1, "by": "display"}
    assert f"at {held['rung']}: this screen drops frames" in held["panel"]
    stats = held["stats"]
    assert stats["droppedByDisplay"] > 0.15 * (stats["framesShown"] + stats["framesDropped"])
    assert chosen["rung"] == first and chosen["stats"]["held"] is None
    assert "drops frames" not in chosen["panel"]
