"""The list of packages, of which one bad one must never take the others from it."""

import gzip
import html
import http.client
import os
import re
import shutil

import pytest

from airgs_codec.package import parse
from airgs_codec.package.index import PAGE
from airgs_codec.package.parse import MAX_VALUES
from airgs_codec.serve import pages
from airgs_codec.serve.pages import describe, list_page
from tests.faces import FormatError, Packages, digest, open_package
from tests.support.effort import few_calls
from tests.support.mutations import apply, edit_text, link_file, read_files, remove_file, set_value, write_files
from tests.support.paths import VALID
from tests.support.servers import serving

TABLE = "group/1.json.gz"
EMPTY = {"frames": [], "segments": [], "bytes": [], "sha256": ""}
MANY = {"frames": [PAGE**4], "segments": [PAGE**4], "bytes": [100], "sha256": "A" * 32}


def table_of(data, size=None):
    """With these bytes as the table of the group, which airgs.json knows."""
    listed = {"frames": [4], "segments": [1], "bytes": [size or len(data)], "sha256": digest(data)}
    return [set_value(("index",), [listed]), lambda files: files | {TABLE: data}]


BAD = {  # name -> changes, and what the list says of it
    "digits": ([set_value(("key_gain",), 10**399)], "airgs.json.key_gain: expected a finite number"),
    "index": ([set_value(("index",), [EMPTY] * 4 + [MANY]), set_value(("frames",), PAGE**4)], "index/4/1.json"),
    "bomb": (table_of(gzip.compress(b'{"repairs":[' + b"[]," * (40 << 20) + b"[]]}")), "too_large"),
    "values": (table_of(gzip.compress(b'{"repairs":[' + b"[]," * (MAX_VALUES // 2 - 9) + b"[]]}")), "missing fields"),
    "long": (table_of(b"", 1 << 31), "too_large"),
    "deep": ([lambda files: files | {"airgs.json": b"[" * 100_000}], "not_json"),
    "linked": ([link_file("airgs.json", "manifest.mpd")], "airgs.json: expected a package"),
    "inner link": ([link_file(TABLE, "../airgs.json")], "got a link"),
    "no mpd": ([remove_file("manifest.mpd")], "manifest.mpd: expected a package"),
    "script": ([edit_text("airgs.json", '"key_gain"', '"<script>\\u001b\\ud800\\n"')], "unknown fields ['<script>"),
}


@pytest.fixture(scope="module")
def holder(tmp_path_factory):
    """A folder of a good package and bad ones."""
    folder, good = tmp_path_factory.mktemp("packages"), read_files(VALID / "moving")
    write_files(folder / "good", good)
    for name, (changes, _) in BAD.items():
        write_files(folder / name, apply(good, *changes))
    os.truncate(folder / "long" / TABLE, 1 << 31)  # a hole
    return folder


def test_a_bad_package_is_a_line_in_the_list_and_the_good_one_another(holder):
    with serving(holder) as port:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=100)
        connection.request("GET", "/")
        response = connection.getresponse()
        page = response.read().decode()
        connection.close()
    items = [html.unescape(item) for item in re.findall("<li>.*<p>(.*)</p><p>", page)]
    said = dict(zip(sorted(["good", *BAD]), items, strict=True))
    assert response.status == 200 and "4 frames" in said.pop("good")
    for name, line in said.items():
        assert line.startswith("cannot be played: ") and BAD[name][1] in line, name
        assert str(holder) not in line and line.isprintable()
    assert "<script>" not in page


def test_what_is_wrong_with_tables_is_found_once(holder):
    """Nobody can keep a server busy by asking for its list."""
    packages = Packages([holder]).now()
    list_page(packages)
    with pytest.MonkeyPatch.context() as patch, few_calls(30_000):
        patch.setattr(parse, "inflate", lambda data, where: pytest.fail(where))
        list_page(packages)


def test_a_fault_that_may_pass_is_looked_for_again(holder, tmp_path):
    package = shutil.copytree(holder / "good", tmp_path / "copied")
    table = (package / TABLE).rename(tmp_path / "table")
    assert "missing_file" in describe(package)
    table.rename(package / TABLE)
    assert describe(package).frames == 4


def test_our_own_failure_on_a_package_is_a_line_as_well(holder, monkeypatch, caplog, tmp_path):
    package = shutil.copytree(holder / "good", tmp_path / "good")
    monkeypatch.setattr(pages, "look_at", lambda *_: 1 // 0)
    assert describe(package) == "cannot be played: reading it failed" and "ZeroDivisionError" in caplog.text


def test_a_folder_that_may_not_be_looked_into_is_none_of_the_list(holder, monkeypatch):
    look = os.stat

    def refuse(path, *arguments, **options):
        if "no mpd" in os.fspath(path):
            raise PermissionError(13, "Permission denied", path)
        return look(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", refuse)
    names = Packages([holder]).now()
    assert "good" in names and "no mpd" not in names


def test_a_file_that_may_not_be_read_is_a_line(holder, tmp_path, monkeypatch):
    package = shutil.copytree(holder / "good", tmp_path / "good")

    def refuse(folder):
        raise PermissionError(13, "Permission denied", f"{folder}/airgs.json")

    monkeypatch.setattr(pages, "open_package", refuse)
    assert describe(package) == "cannot be played: [Errno 13] Permission denied: 'airgs.json'"


def test_a_table_that_is_too_long_is_not_read(holder):
    package = open_package(holder / "long")
    with pytest.raises(FormatError, match="too_large"):
        package.manifest.group_files(0)
