"""The player above the packages: what is sent, with which headers, and what stands in the list of packages."""

import base64
import hashlib
import http.client
import json
import re
import shutil
from urllib.parse import parse_qs, unquote, urljoin, urlsplit

import pytest

from airgs_codec.serve import pages
from airgs_codec.serve.pages import look_at, player_address
from tests.faces import open_package, pooled_quality
from tests.support.page import FILES, INLINE, put_page
from tests.support.paths import VALID
from tests.support.servers import serving

PACKAGE = VALID / "two-groups-sh1"
POLICY = "Content-Security-Policy"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        yield put_page(tmp_path_factory.mktemp("page"), patch)


@pytest.fixture(scope="module")
def holder(tmp_path_factory):
    """A folder with two packages and other things, one package with the name of a file of the player."""
    folder = tmp_path_factory.mktemp("demo")
    shutil.copytree(PACKAGE, folder / "player.html")
    shutil.copytree(VALID / "moving", folder / "a <b>&?#%é.airgs")
    shutil.copytree(VALID / "moving", folder / ".hidden.airgs")
    (folder / "report").mkdir()
    (folder / "ladder.png").touch()
    (folder / "linked").symlink_to(PACKAGE)
    return folder


@pytest.fixture(scope="module")
def port(page, holder):
    with serving(holder) as port:
        yield port


def ask(port, path, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request(method, path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    response = connection.getresponse()
    data = response.read()
    connection.close()
    return response.status, response.headers, data


def listed(port):
    return json.loads(ask(port, "/", Accept="application/json")[2])


def directives(headers):
    return dict(part.strip().split(" ", 1) for part in headers[POLICY].split(";"))


@pytest.mark.parametrize("name", FILES)
def test_the_files_of_the_player_are_sent_to_pages_of_all_origins_and_asked_for_again(port, name):
    status, headers, body = ask(port, f"/{name}")
    assert (status, body) == (200, FILES[name].encode())
    kind = "text/html" if name.endswith(".html") else "text/javascript"
    assert headers["Content-Type"] == f"{kind}; charset=utf-8" and headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-cache" and headers["Access-Control-Allow-Origin"] == "*"
    again = ask(port, f"/{name}", If_None_Match=headers["ETag"])
    assert (again[0], again[2]) == (304, b"")
    status, head, body = ask(port, f"/{name}", "HEAD")
    assert (status, body, head["Content-Length"]) == (200, b"", headers["Content-Length"])
    assert head["ETag"] == headers["ETag"]


def test_a_player_that_is_built_anew_is_sent_anew(port, page):
    old = ask(port, "/airgs.js")[1]["ETag"]
    try:
        (page / "airgs.js").write_text("export const open = 1;" + " " * 3000)
        status, headers, body = ask(port, "/airgs.js", If_None_Match=old, Accept_Encoding="gzip")
        assert status == 200 and headers["Content-Encoding"] == "gzip" and len(body) < 200
        (page / "airgs.js").unlink()
        status, _, body = ask(port, "/airgs.js")
        assert status == 404 and b"make page" in body
    finally:
        (page / "airgs.js").write_text(FILES["airgs.js"])


def test_the_page_may_do_what_the_player_does_and_nothing_else(port):
    allowed = directives(ask(port, "/player.html")[1])
    digest = base64.b64encode(hashlib.sha256(INLINE.encode()).digest()).decode()
    assert allowed["default-src"] == allowed["base-uri"] == allowed["form-action"] == "'none'"
    assert allowed["script-src"] == f"'self' 'sha256-{digest}'"
    assert allowed["worker-src"] == "blob:" and allowed["connect-src"] == "*"
    assert directives(ask(port, "/")[1])["script-src"] == "'self'"
    assert POLICY not in ask(port, "/airgs.js")[1]


def test_a_folder_of_packages_is_served_with_all_of_them(port):
    assert [entry["name"] for entry in listed(port)] == ["a <b>&?#%é.airgs", "player.html"]
    assert ask(port, "/player.html/airgs.json")[2] == (PACKAGE / "airgs.json").read_bytes()
    assert ask(port, "/player.html")[2] == FILES["player.html"].encode()
    for hidden in ("/.hidden.airgs/airgs.json", "/linked/airgs.json", "/report/airgs.json", "/../demo/airgs.json"):
        assert ask(port, hidden)[0] == 404, hidden
    assert ask(port, "/ladder.png")[0] == 404


def test_the_list_leads_to_the_player_and_the_player_to_the_package(port):
    text = ask(port, "/")[2].decode()
    for entry in listed(port):
        assert f'href="{entry["play"]}"' in text
        address = urljoin(f"http://127.0.0.1:{port}/", entry["play"])
        assert ask(port, urlsplit(address).path)[0] == 200
        (source,) = parse_qs(urlsplit(address).query)["src"]
        root = urlsplit(urljoin(address, f"{source}airgs.json"))
        assert unquote(root.path) == f"/{entry['name']}/airgs.json" and not root.query + root.fragment
        assert ask(port, root.path)[0] == 200
    assert "<b>" not in text and player_address("fox.airgs") == "/player.html?src=fox.airgs/"


def test_the_list_says_what_each_package_is(port):
    text = ask(port, "/")[2].decode()
    size = sum(path.stat().st_size for path in PACKAGE.rglob("*") if path.is_file())
    m = open_package(PACKAGE).manifest
    quality = pooled_quality(m, 0, 0).psnr
    best = 8e-6 * sum((PACKAGE / path).stat().st_size for path in m.rung_files(0, 0)) * float(m.fps) / m.frames
    assert f"0.2 s · 5 frames · {size / 1e3:.3g} kB · {best:.3g} Mbit/s and {quality:.1f} dB at best" in text


def test_a_card_has_the_poster_and_the_credit_of_its_package_as_text(page, demo_package, tmp_path):
    package = shutil.copytree(demo_package, tmp_path / "a#b%.airgs")
    root = json.loads((package / "airgs.json").read_text())
    (package / "airgs.json").write_text(json.dumps(root | {"attribution": "by <i>me</i>\nand\u202eyou"}))
    with serving(tmp_path) as port:
        text = ask(port, "/")[2].decode()
        (poster,) = re.findall('<img src="([^"]*)"', text)
        assert ask(port, poster)[2] == (package / "poster.jpg").read_bytes()
    assert "<p>by &lt;i&gt;me&lt;/i&gt;</p><p>and\\u202eyou</p>" in text and "a#b%</span>" in text


def test_of_a_long_package_the_first_groups_stand_for_all(monkeypatch):
    package = open_package(PACKAGE)
    whole = look_at(package.manifest, 1000)
    monkeypatch.setattr(pages, "LOOKED_AT", 1)
    guess = look_at(package.manifest, 1000)
    assert (whole.whole, guess.whole, guess.frames) == (True, False, whole.frames)
    assert guess.bytes == pytest.approx(whole.bytes, rel=0.5) and guess.psnr == pytest.approx(whole.psnr, abs=3)
    assert " about " in guess.words and "about" not in whole.words


def test_packages_that_appear_go_or_break_are_listed_as_they_are(page, tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "first")
    with serving(tmp_path) as port:
        assert ask(port, "/second/airgs.json")[0] == 404
        shutil.copytree(VALID / "moving", tmp_path / "second")
        assert ask(port, "/second/airgs.json")[0] == 200
        assert [entry["name"] for entry in listed(port)] == ["first", "second"]
        (tmp_path / "second/airgs.json").write_text("{}")
        status, _, text = ask(port, "/")
        assert status == 200 and b"cannot be played: airgs.json" in text
        shutil.rmtree(tmp_path / "first")
        assert [entry["name"] for entry in listed(port)] == ["second"]
        assert ask(port, "/first/airgs.json")[0] == 404
