"""airgs-manifest export-page: what a static host gets, and that nothing half-written is ever left."""

import html
import shutil
from html.parser import HTMLParser
from urllib.parse import unquote, urljoin

import pytest

from tests.faces import ConfigError, airgs_manifest, export_page, open_package, validate
from tests.support.mutations import on_disk, read_files, rewrite, set_value
from tests.support.page import FILES, put_page
from tests.support.paths import VALID

PACKAGE = VALID / "two-groups-sh1"
SCRIPTS = ("airgs-player.js", "airgs-vr.js", "airgs-more.js", "airgs-sound.js")
TOP = {"index.html", ".nojekyll", *SCRIPTS, "packages"}


@pytest.fixture(autouse=True)
def page(tmp_path_factory, monkeypatch):
    return put_page(tmp_path_factory.mktemp("page"), monkeypatch)


def elements_of(page):
    found, parser = [], HTMLParser()
    parser.handle_starttag = lambda tag, attributes: found.append((tag, dict(attributes)))
    parser.feed(page.read_text())
    return found


def one(elements, tag, **wanted):
    (attributes,) = [a for name, a in elements if name == tag and wanted.items() <= a.items()]
    return attributes


def run(*arguments):
    return airgs_manifest(["export-page", *map(str, arguments)])


def target(site, page, address):
    """The file that a static host sends for an address on a page of the site."""
    return site / unquote(urljoin(page, address))


def test_one_package_is_played_by_the_first_page(tmp_path, capsys):
    site = tmp_path / "site"
    assert run(PACKAGE, "-o", site, "--title", 'A <scene> & "more"') == 0
    assert {path.name for path in site.iterdir()} == TOP
    assert read_files(site / "packages" / PACKAGE.name) == read_files(PACKAGE)
    assert validate(site / "packages" / PACKAGE.name) == []
    for name in SCRIPTS:
        assert (site / name).read_text() == FILES[name]
    text, elements = (site / "index.html").read_text(), elements_of(site / "index.html")
    player = one(elements, "airgs-player")
    assert target(site, "index.html", f"{player['src']}airgs.json").is_file() and player["src"].endswith("/")
    assert "poster" not in player and not any(a.get("property") == "og:image" for _, a in elements)
    assert target(site, "index.html", one(elements, "script")["src"]).is_file()
    assert "<title>A &lt;scene&gt; &amp; &quot;more&quot;</title>" in text
    assert one(elements, "meta", property="og:title")["content"] == 'A <scene> & "more"'
    out = capsys.readouterr().out
    assert "5 frames" in out and f"--directory {site}" in out


def test_the_page_shows_poster_and_credit_and_may_load_the_player_but_no_script_of_its_own(demo_package, tmp_path):
    site = tmp_path / "site"
    export_page([demo_package], site)
    elements = elements_of(site / "index.html")
    policy = one(elements, "meta", **{"http-equiv": "Content-Security-Policy"})["content"]
    assert "default-src 'none'" in policy and "script-src 'self';" in policy and "worker-src blob:" in policy
    assert all("src" in attributes for tag, attributes in elements if tag == "script")
    player, image = one(elements, "airgs-player"), one(elements, "meta", property="og:image")["content"]
    assert player["poster"] == image and target(site, "index.html", image) == site / "packages/fox.airgs/poster.jpg"
    credit = open_package(demo_package).manifest.attribution
    assert credit and credit.strip() in one(elements, "meta", name="description")["content"]
    assert f"<footer>{html.escape(credit)}</footer>" in (site / "index.html").read_text()


def test_several_packages_have_a_page_each_and_a_list(demo_package, tmp_path):
    odd = shutil.copytree(demo_package, tmp_path / "a <b>&?#%é.airgs")
    site = tmp_path / "site"
    assert run(demo_package, odd, "-o", site, "--address", "https://example.org/scenes") == 0
    assert {path.name for path in site.iterdir()} == TOP | {"play"}
    listed = elements_of(site / "index.html")
    links, pictures = ([a[word] for tag, a in listed if tag == name] for name, word in (("a", "href"), ("img", "src")))
    assert all(target(site, "index.html", link).is_file() for link in links + pictures) and len(pictures) == 2
    links = [unquote(link) for link in links if link.startswith("play/")]
    for path, name in zip(links, (demo_package.name, odd.name), strict=True):
        elements = elements_of(site / path)
        player = one(elements, "airgs-player")
        assert target(site, path, f"{player['src']}airgs.json") == site / "packages" / name / "airgs.json"
        assert target(site, path, player["poster"]).is_file()
        assert target(site, path, one(elements, "script")["src"]).is_file()
        image = one(elements, "meta", property="og:image")["content"]
        assert target(site, "", image.removeprefix("https://example.org/scenes/")).is_file()


def test_an_exported_page_is_replaced_and_leaves_nothing_of_the_old_one(tmp_path):
    site = tmp_path / "site"
    assert run(PACKAGE, VALID / "moving", "-o", site) == 0
    assert run(VALID / "moving", "-o", site) == 0
    assert {path.name for path in site.iterdir()} == TOP
    assert [path.name for path in (site / "packages").iterdir()] == ["moving"]
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


def altered(name, *changes):
    """A function that makes a copy of the package with these changes in a folder."""
    return lambda folder: on_disk(shutil.copytree(PACKAGE, folder / name), *changes)


@pytest.mark.parametrize(("make", "words"), [
    (altered("broken", rewrite("delta/L0/3.m4s", lambda data: data[:-1] + b"?")), "hash_mismatch"),
    (altered("growing", set_value(("live",), True)), "still growing"),
    (lambda folder: folder / "nothing", "missing_file"),
    (lambda folder: "ftp://a/b", "expected a folder or an address"),
    (altered("other/moving"), "different names"),
])  # fmt: skip
@pytest.mark.parametrize("before", [False, True])
def test_a_package_that_cannot_be_exported_changes_nothing(tmp_path, capsys, make, words, before):
    package, site = make(tmp_path), tmp_path / "out" / "site"
    if before:
        assert run(VALID / "moving", "-o", site) == 0
    old = read_files(site) if before else {}
    capsys.readouterr()
    assert run(VALID / "moving", package, "-o", site) == 2
    line = capsys.readouterr().err
    assert words in line and line.count("\n") == 1
    assert (read_files(site) if site.exists() else {}) == old
    assert not site.parent.exists() or [path.name for path in site.parent.iterdir()] == ["site"] * before


def test_a_package_that_changes_meanwhile_is_refused(tmp_path):
    package, site = shutil.copytree(PACKAGE, tmp_path / "changing"), tmp_path / "site"
    change = set_value(("attribution",), "somebody else")
    with pytest.raises(ConfigError, match="changed meanwhile"):
        export_page([package], site, progress=lambda *_: on_disk(package, change))
    assert not site.exists()


@pytest.mark.parametrize("name", ["notes.txt", ".git/config", "CNAME", "index.html"])
def test_a_folder_with_other_files_is_never_replaced(tmp_path, capsys, name):
    site = tmp_path / "site"
    assert name == "index.html" or run(PACKAGE, "-o", site) == 0  # that page was not exported
    (site / name).parent.mkdir(exist_ok=True)
    (site / name).write_text("mine")
    before = read_files(site)
    assert run(PACKAGE, "-o", site) == 2
    assert "other files" in capsys.readouterr().err and read_files(site) == before
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


def test_without_a_player_nothing_is_written(tmp_path, page, capsys):
    (page / "airgs-player.js").unlink()
    assert run(PACKAGE, "-o", tmp_path / "site") == 2
    line = capsys.readouterr().err
    assert "the player is not built: run make page" in line and line.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
