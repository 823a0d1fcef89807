"""The pages that are published, with nothing of a test in them: they play, and ask nobody else."""

from urllib.parse import quote, urlsplit

import pytest

from airgs_codec.package.package import open_package
from airgs_codec.serve.export import export_page
from tests.support.browser import WEB, Answer, missing, serve, visit
from tests.support.paths import GOLDEN
from tests.support.repeated import write_repeated
from tests.support.servers import plainly_serving, serving

LOOK = b"""
window.report = new Promise((resolve) => {
  const timer = setInterval(() => {
    const { player } = document.querySelector("airgs-player") ?? {};
    if (!player || player.stats.framesShown < 3) return;
    clearInterval(timer);
    const asked = performance.getEntriesByType("resource").map(({ name }) => name);
    resolve({ shown: player.stats.framesShown, asked, paused: player.paused });
  }, 50);
});
"""

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    return write_repeated(open_package(GOLDEN / "fox"), tmp_path_factory.mktemp("pages") / "fox.airgs", 2, 4)


def check_plays(url):
    """The page plays, complains of nothing, and asks only the server it came from."""
    seen = visit(url, LOOK.decode())
    assert seen.complaints() == []
    assert seen.report["shown"] >= 3 and not seen.report["paused"]
    assert {urlsplit(asked).netloc for asked in seen.report["asked"] if asked.startswith("http")} <= {
        urlsplit(url).netloc
    }


def test_the_page_of_the_server_plays(package):
    with serving(package) as port:
        check_plays(f"http://127.0.0.1:{port}/player.html?src={quote('/fox.airgs/')}")


def test_an_exported_site_plays_from_a_folder_of_a_plain_server(package, tmp_path):
    export_page([package], tmp_path / "some" / "where")
    with plainly_serving(tmp_path) as port:
        check_plays(f"http://127.0.0.1:{port}/some/where/")


def test_the_example_of_a_page_of_ones_own_plays(package):
    with serving(package) as port:
        text = (
            (WEB / "examples" / "embed.html").read_text().replace("http://127.0.0.1:8000", f"http://127.0.0.1:{port}")
        )
        with serve({}, {"/": lambda: Answer(text.encode(), headers={"Content-Type": "text/html"})}) as site:
            seen = visit(f"{site.url}/", LOOK.decode())
    assert seen.complaints() == []
    assert seen.report["shown"] >= 3
