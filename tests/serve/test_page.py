"""The player above the packages, the list of packages, of which no bad one takes the others, and their files."""

import base64
import gzip
import hashlib
import html
import json
import os
import re
import shutil
from urllib.parse import parse_qs, unquote, urljoin, urlsplit

import pytest

from tests.faces import PAGE, ConfigError, Packages, describe, digest, list_page, media_type, open_package
from tests.support.effort import few_calls
from tests.support.mutations import apply, edit_text, link_file, read_files, remove_file, set_value, write_files
from tests.support.page import FILES, INLINE, put_page
from tests.support.paths import VALID
from tests.support.servers import ask, serving

PACKAGE = VALID / "two-groups-sh1"
DELTA = "delta/L0/1.m4s"
POLICY = "Content-Security-Policy"
STRANGE = "a <b>&?#%é.airgs"
TABLE = "group/1.json.gz"
EMPTY = {"frames": [], "segments": [], "bytes": [], "sha256": ""}
MANY = {"frames": [PAGE**4], "segments": [PAGE**4], "bytes": [100], "sha256": "A" * 32}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        yield put_page(tmp_path_factory.mktemp("page"), patch)


@pytest.fixture
def package(tmp_path):
    return shutil.copytree(PACKAGE, tmp_path / "two.airgs")


@pytest.fixture(scope="module")
def port(page, tmp_path_factory):
    """Of a folder with two packages and other things, one package with the name of a file of the player."""
    folder = tmp_path_factory.mktemp("demo")
    shutil.copytree(PACKAGE, folder / "player.html")
    shutil.copytree(VALID / "moving", folder / STRANGE)
    shutil.copytree(VALID / "moving", folder / ".hidden.airgs")
    (folder / "report").mkdir()
    (folder / "ladder.png").touch()
    (folder / "linked").symlink_to(PACKAGE)
    with serving(folder) as port:
        yield port


def listed(port):
    """The cards of the list: the name of each package, its player, and its two tables."""
    anchors = '<li><a href="([^"]*)">.*?<a href="/([^/]*)/airgs.json">.*?<a href="([^"]*)">'
    for play, name, mpd in re.findall(anchors, ask(port, "/")[2].decode()):
        yield {"name": unquote(name), "play": html.unescape(play), "tables": f"/{name}/airgs.json", "mpd": mpd}


@pytest.mark.parametrize("name", FILES)
def test_the_files_of_the_player_are_sent_to_pages_of_all_origins_and_asked_for_again(port, name):
    status, headers, body = ask(port, f"/{name}")
    assert (status, body) == (200, FILES[name].encode())
    kind = "text/html" if name.endswith(".html") else "text/javascript"
    assert headers["Content-Type"] == f"{kind}; charset=utf-8" and headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-cache" and headers["Access-Control-Allow-Origin"] == "*"
    assert ask(port, f"/{name}", If_None_Match=headers["ETag"])[0::2] == (304, b"")
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
    policies = (ask(port, path)[1][POLICY].split(";") for path in ("/player.html", "/"))
    allowed, on_list = (dict(part.strip().split(" ", 1) for part in policy) for policy in policies)
    inline = base64.b64encode(hashlib.sha256(INLINE.encode()).digest()).decode()
    assert allowed["default-src"] == allowed["base-uri"] == allowed["form-action"] == "'none'"
    assert allowed["script-src"] == f"'self' 'sha256-{inline}'"
    assert allowed["worker-src"] == "blob:" and allowed["connect-src"] == "*"
    assert on_list["script-src"] == "'self'"
    assert POLICY not in ask(port, "/airgs.js")[1]


def test_a_folder_of_packages_is_served_with_all_of_them(port):
    assert [entry["name"] for entry in listed(port)] == [STRANGE, "player.html"]
    assert ask(port, "/player.html/airgs.json")[2] == (PACKAGE / "airgs.json").read_bytes()
    assert ask(port, "/player.html")[2] == FILES["player.html"].encode()
    for hidden in ("/.hidden.airgs/airgs.json", "/linked/airgs.json", "/report/airgs.json", "/../demo/airgs.json"):
        assert ask(port, hidden)[0] == 404, hidden
    assert ask(port, "/ladder.png")[0] == 404


def test_the_list_says_what_each_package_is_and_leads_to_the_player_and_the_player_to_the_package(port):
    text, package = ask(port, "/")[2].decode(), open_package(PACKAGE)
    m = package.manifest
    size, quality = sum(len(data) for data in read_files(PACKAGE).values()), m.rungs[0][0].psnr
    best = 8e-6 * package.rungs[0].bytes * float(m.fps) / m.frames
    assert f"0.2 s · 5 frames · {size / 1e3:.3g} kB · {best:.2f} Mbit/s and {quality:.1f} dB at best" in text
    for entry in listed(port):
        assert f'href="{entry["play"]}"' in text and entry["mpd"] in text
        assert ask(port, entry["tables"])[0] == ask(port, entry["mpd"])[0] == 200
        address = urljoin(f"http://127.0.0.1:{port}/", entry["play"])
        assert ask(port, urlsplit(address).path)[0] == 200
        (source,) = parse_qs(urlsplit(address).query)["src"]
        root = urlsplit(urljoin(address, f"{source}airgs.json"))
        assert unquote(root.path) == f"/{entry['name']}/airgs.json" and not root.query + root.fragment
        assert ask(port, root.path)[0] == 200
    assert "<b>" not in text and entry["play"] == "/player.html?src=player.html/"


def test_a_card_has_the_poster_and_the_credit_of_its_package_as_text(page, demo_package, tmp_path):
    package = shutil.copytree(demo_package, tmp_path / "a#b%.airgs")
    root = json.loads((package / "airgs.json").read_text())
    (package / "airgs.json").write_text(json.dumps(root | {"attribution": "by <i>me</i>\nand\u202eyou"}))
    with serving(tmp_path) as port:
        text = ask(port, "/")[2].decode()
        (poster,) = re.findall('<img src="([^"]*)"', text)
        assert ask(port, poster)[2] == (package / "poster.jpg").read_bytes()
    assert "<p>by &lt;i&gt;me&lt;/i&gt;</p><p>and\\u202eyou</p>" in text and "a#b%</span>" in text


def test_of_a_long_package_the_first_groups_stand_for_all(package, monkeypatch):
    whole = describe(PACKAGE)
    monkeypatch.setattr("airgs_codec.serve.pages.GROUPS_READ", 1)
    guess = describe(package)
    for form, near in ((" (\\S+) kB", {"rel": 0.5}), ("(\\S+) dB", {"abs": 3})):
        first, second = (float(re.search(form, seen.words)[1]) for seen in (whole, guess))
        assert second == pytest.approx(first, **near)
    assert " about " in guess.words and "about" not in whole.words and "5 frames" in guess.words


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


def table_of(data, size=None):
    """With these bytes as the table of the group, which airgs.json knows."""
    entry = {"frames": [4], "segments": [1], "bytes": [size or len(data)], "sha256": digest(data)}
    return [set_value(("index",), [entry]), lambda files: files | {TABLE: data}]


BAD = {  # name -> changes, and what the list says of it
    "digits": ([set_value(("keyframe_gain",), 10**399)], "airgs.json.keyframe_gain: expected a finite number"),
    "index": ([set_value(("index",), [EMPTY] * 4 + [MANY]), set_value(("frames",), PAGE**4)], "index/4/1.json"),
    "bomb": (table_of(gzip.compress(b'{"repairs":[' + b"[]," * (40 << 20) + b"[]]}")), "too_large"),
    "values": (table_of(gzip.compress(b'{"repairs":[' + b"[]," * ((1 << 20) - 9) + b"[]]}")), "missing fields"),
    "long": (table_of(b"", 1 << 31), "too_large"),
    "deep": ([lambda files: files | {"airgs.json": b"[" * 100_000}], "not_json"),
    "linked": ([link_file("airgs.json", "manifest.mpd")], "airgs.json: expected a package"),
    "inner link": ([link_file(TABLE, "../airgs.json")], "got a link"),
    "no mpd": ([remove_file("manifest.mpd")], "manifest.mpd: expected a package"),
    "script": (
        [edit_text("airgs.json", '"keyframe_gain"', '"<script>\\u001b\\ud800\\n"')],
        "unknown fields ['<script>",
    ),
}


@pytest.fixture(scope="module")
def holder(tmp_path_factory):
    folder, good = tmp_path_factory.mktemp("packages"), read_files(VALID / "moving")
    write_files(folder / "good", good)
    for name, (changes, _) in BAD.items():
        write_files(folder / name, apply(good, *changes))
    os.truncate(folder / "long" / TABLE, 1 << 31)  # a hole
    return folder


def test_a_bad_package_is_a_line_in_the_list_and_the_good_one_another(holder):
    with serving(holder) as port:
        status, _, body = ask(port, "/")
    text = body.decode()
    items = [html.unescape(item) for item in re.findall("<li>.*<p>(.*)</p><p>", text)]
    said = dict(zip(sorted(["good", *BAD]), items, strict=True))
    assert status == 200 and "4 frames" in said.pop("good")
    for name, line in said.items():
        assert line.startswith("cannot be played: ") and BAD[name][1] in line, name
        assert str(holder) not in line and line.isprintable()
    assert "<script>" not in text


def test_what_is_wrong_with_tables_is_found_once(holder):
    """Nobody can keep a server busy by asking for its list."""
    packages = Packages([holder]).now()
    list_page(packages)
    with pytest.MonkeyPatch.context() as patch, few_calls(30_000):
        patch.setattr("airgs_codec.package.parse.inflate", lambda data, where: pytest.fail(where))
        list_page(packages)


def test_a_fault_that_may_pass_is_looked_for_again(package, tmp_path):
    table = (package / TABLE).rename(tmp_path / "table")
    assert "missing_file" in describe(package)
    table.rename(package / TABLE)
    assert "5 frames" in describe(package).words


def forbidden(*arguments):
    raise PermissionError(13, "Permission denied", f"{arguments[0]}/airgs.json")


@pytest.mark.parametrize(("name", "instead", "words"), [
    ("look_at", lambda *_: 1 // 0, "reading it failed"),  # our own failure
    ("open_package", forbidden, "[Errno 13] Permission denied: 'airgs.json'"),  # a file that may not be read
])  # fmt: skip
def test_any_failure_is_a_line(package, monkeypatch, caplog, name, instead, words):
    monkeypatch.setattr(f"airgs_codec.serve.pages.{name}", instead)
    assert describe(package) == f"cannot be played: {words}"
    assert ("ZeroDivisionError" in caplog.text) is (name == "look_at")


def test_a_folder_that_may_not_be_looked_into_is_none_of_the_list(holder, monkeypatch):
    look = os.stat

    def refuse(path, *arguments, **options):
        return forbidden(path) if "no mpd" in os.fspath(path) else look(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", refuse)
    names = Packages([holder]).now()
    assert "good" in names and "no mpd" not in names


@pytest.mark.parametrize(("path", "expected"), [
    ("airgs.json", "application/json"),      ("group/7.json.gz", "application/gzip"),
    ("index/1/12.json", "application/json"), ("keyframe/T0/1.bin", "application/octet-stream"),
    ("init.mp4", "video/mp4"),               (DELTA, "video/mp4"), ("manifest.mpd", "application/dash+xml"),
    *((path, None) for path in ("", "notes.json", "airgs.json/", "keyframe", "keyframe/T0/notes.txt", "x/1.bin")),
    *((path, None) for path in ("delta/../airgs.json", "delta/./1.bin", "/airgs.json", "delta//1.bin", "delta/.b.bin")),
    *((path, None) for path in (".airgs.json.part", "airgs.json\n", "delta/1.bin\0", "delta\\1.bin", "delta/é/1.bin")),
])  # fmt: skip
def test_a_path_has_a_type_or_is_none_of_a_package(path, expected):
    assert media_type(path) == expected


def test_links_folders_and_what_is_no_plain_file_are_not_there(package, tmp_path):
    (tmp_path / "secret.m4s").write_bytes(b"secret")
    (package / "delta/L0/8.m4s").symlink_to(tmp_path / "secret.m4s")
    (package / "delta/L0/9.m4s").symlink_to(package / DELTA)
    (package / "delta/L0/10.m4s").symlink_to("10.m4s")
    (package / "delta/L9").symlink_to(package / "delta/L0")
    (package / "delta/L0/7.m4s").mkdir()
    os.mkfifo(package / "delta/L0/6.m4s")
    (tmp_path / "linked").symlink_to(package)
    for folder in (package, tmp_path / "linked"):
        with serving(folder) as port:
            assert ask(port, f"/two.airgs/{DELTA}")[0::2] == (200, (PACKAGE / DELTA).read_bytes())
            for path in (*(f"delta/L0/{n}.m4s" for n in (6, 7, 8, 9, 10, 11)), "delta/L9/1.m4s", f"{DELTA}/1.m4s"):
                assert ask(port, f"/two.airgs/{path}")[0] == 404, path
            assert ask(port, f"/two.airgs/delta/L0/{'x' * 9000}.m4s")[0] == 404


def test_folders_must_be_packages_of_different_names(package, tmp_path):
    with pytest.raises(ConfigError, match=r"nothing.*expected a package"):
        Packages([tmp_path / "nothing"])
    (tmp_path / "frames").mkdir()
    assert list(Packages([package, tmp_path / "frames"]).now()) == ["two.airgs"]
    (tmp_path / "frames" / "0.ply").touch()
    with pytest.raises(ConfigError, match=r"frames: expected a package.*, a folder with packages or an empty one"):
        Packages([package, tmp_path / "frames"])
    other = shutil.copytree(package, tmp_path / "other" / "two.airgs")
    for second in (other, other.parent):
        with pytest.raises(ConfigError, match="twice"):
            Packages([package, second])


def test_of_two_packages_of_one_name_the_one_that_was_named_first_is_served(package, tmp_path):
    shelves = [tmp_path / "a", tmp_path / "b"]
    for shelf, name in zip(shelves, ("x", "y"), strict=True):
        shutil.copytree(package, shelf / name)
    packages = Packages([*shelves, package])
    for name in ("x", "y", "two.airgs"):
        for shelf in shelves:
            shutil.copytree(package, shelf / name, dirs_exist_ok=True)
    expected = {"two.airgs": package, "x": shelves[0] / "x", "y": shelves[0] / "y"}
    assert packages.now() == expected
