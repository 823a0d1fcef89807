"""The pages that are published, with nothing of a test in them: they play, and ask nobody else."""

import shutil
from urllib.parse import quote, urlsplit

import pytest

from tests.faces import export_page, open_package
from tests.support.browser import WEB, Answer, missing, serve, visit
from tests.support.paths import GOLDEN, REPOSITORY, VALID
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

SHOWCASE = REPOSITORY / "manifests" / "showcase"
WIDTHS = (390, 768, 1280)
LAID_OUT = """
window.report = new Promise((resolve) => {
  addEventListener("load", async () => {
    const seen = [];
    for (const width of WIDTHS) {
      await window.drive("setViewportSize", { width, height: 800 });
      await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
      const cards = [...document.querySelectorAll("li")].map((card) => card.getBoundingClientRect());
      const pictures = [...document.querySelectorAll("img")].map((image) => image.getBoundingClientRect().toJSON());
      const abreast = cards.filter(({ top }) => top === cards[0].top).length;
      const loaded = [];
      for (const image of document.querySelectorAll("img")) {
        image.scrollIntoView(); // they are not fetched before
        await image.decode();
        loaded.push(image.naturalWidth > 0);
      }
      scrollTo(0, 0);
      seen.push({ width, needs: document.documentElement.scrollWidth, abreast, pictures, loaded });
    }
    resolve({ seen });
  });
});
""".replace("WIDTHS", str(list(WIDTHS)))

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


def check_laid_out(url):
    """As many cards abreast as there is room, whatever their names, with posters of one shape."""
    seen = visit(url, LAID_OUT)
    assert seen.complaints() == []
    shown = seen.report["seen"]
    assert [one["abreast"] for one in shown] == [1, 2, 4]
    for one in shown:
        assert one["needs"] <= one["width"] and len(one["loaded"]) == 2 and all(one["loaded"])
        assert {round(picture["width"] / picture["height"], 2) for picture in one["pictures"]} == {1.33}


def test_lists_of_packages_fit_phones_tablets_and_desks(tmp_path):
    shown = [SHOWCASE / "fox.airgs", SHOWCASE / "head.airgs"]
    names = ["moving", "a name_" + 9 * "without_room_"]
    plain = [shutil.copytree(VALID / "moving", tmp_path / "plain" / name) for name in names]
    with serving(*shown, *plain) as port:
        check_laid_out(f"http://127.0.0.1:{port}/")
    export_page([*shown, *plain], tmp_path / "site")
    with plainly_serving(tmp_path / "site") as port:
        check_laid_out(f"http://127.0.0.1:{port}/")
