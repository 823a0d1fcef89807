"""What is published comes from one file of figures: a number of README or docs/results that it lacks is found."""

import json
import math
import re
import shlex

import pytest

from tests.faces import ConfigError
from tests.support.paths import REPOSITORY
from tools.check_docs import command_error
from tools.lab import Page, PagePicture, Section, Table, published
from tools.lab.command import PROGRAM, measurement_of
from tools.lab.experiments import FIGURES, MEASUREMENTS, Measurement
from tools.lab.page import Made
from tools.lab.rd.subject import RdPoint, bd_rate, kb_at

PAGES = sorted(published.RESULTS.glob("*.md"))
ENTRY = {
    "command": "airgs-encode --levels 7", "how": "It takes 1.5 s, 4 of 9.", "seconds": 81.2,
    "tables": {"a": {"columns": ["kb", "share, %", "of"], "rows": [[13.84, 0.2571, "x"], [1236.4, -0.000213, None]]}},
}  # fmt: skip


def own(path):
    """The entries that a page shows, asks in a check, or is the document of; README and the first page show all."""
    text, entries = path.read_text(), published.read_figures()
    named = {mark.partition("/")[0] for mark in published.marks_in(path)}
    named |= {name for check in published.CHECK.findall(text) for name, _, _ in published.REFERENCE.findall(check)}
    return {
        key: one for key, one in entries.items()
        if path.stem in ("README", one["document"]) or key in named or named & one["tables"].keys()
    }  # fmt: skip


@pytest.mark.parametrize("path", [REPOSITORY / "README.md", *PAGES], ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_every_number_of_results_is_in_the_file_of_figures_and_every_comparison_is_checked_and_true(path):
    text, entries = path.read_text(), published.read_figures()
    assert published.unsourced(text, own(path)) == []
    assert [check for check in published.CHECK.findall(text) if not published.holds(check, entries)] == []
    assert path not in PAGES or published.unchecked(text) == []


@pytest.mark.parametrize(("check", "true"), [
    ("a.kb > 13", True), ("a.kb > 14", False), ("one[x].kb < 13.9", True), ("a[!x].kb > 1000", True),
    ("max(a.kb) - min(a.kb) > 1222 and a[x; 13.84].share_ < 0.5*2", True), ("count(a.kb > 14) == 1", True),
    ("abs(-a[x].kb) == 13.84 and a[x].of == 'y'", False), ("a[!x].of < 1", False),
    ("b.kb > 1", "b: no such"), ("a[y].kb > 1", "no such row"), ("a.db > 1", "'db'"), ("a.kb >", "invalid"),
    ("open('x') == 1", "expected comparisons"), ("().__class__ == 1", "expected comparisons"),
])  # fmt: skip
def test_a_check_is_true_or_false_of_figures_or_says_what_is_not_there(check, true):
    if isinstance(true, str):
        with pytest.raises(ConfigError, match=re.escape(true)):
            published.holds(check, {"one": ENTRY})
    else:
        assert published.holds(check, {"one": ENTRY}) is true


@pytest.mark.parametrize(("text", "found"), [
    ("Ours takes less. <!-- true: a.kb > 1 --> It takes 3 kB.", []),
    ("Ours takes less. It takes 3 kB. <!--\ntrue: a.kb > 1 -->", ["Ours takes less."]),
    ("# No more\n\n```sh\nless\n```\n| a | is better |\n|---|---|", ["| a | is better |"]),
    ("- A is\n  larger. <!-- true: a.kb > 1 -->\n- B is twice\n  that", ["- B is twice\n  that"]),
    ("<!-- tools.lab a/b: begin -->\n|times|\n<!-- tools.lab a/b: end -->", []),
])  # fmt: skip
def test_a_comparison_without_a_check_is_found(text, found):
    assert published.unchecked(text) == found


def test_every_measurement_has_its_place_in_a_document_and_every_entry_is_made_by_its_command():
    entries = published.read_figures()
    commands = {one.name: (one.document, f"{PROGRAM} {one.words}") for one in MEASUREMENTS}
    assert len(commands) == len(MEASUREMENTS)
    assert all(name in own(published.RESULTS / f"{document}.md") for name, (document, _) in commands.items())
    assert {name: (one["document"], one["command"]) for name, one in entries.items()} == commands
    assert all(one["seconds"] > 0 and one["date"] and one["machine"] and one["commit"] for one in entries.values())


@pytest.mark.parametrize(("text", "missing"), [
    ("13.8 kB, 13.84, 26 %, 25.7 %, 1,236 and 2e-4 in 81 s of 9 tries, `--levels 7`", []),
    ("13.9 kB, 14 kB, 25 %", ["13.9", "25"]),
    ("1,237 in 1.5 s with 7 levels", ["1,237"]),
    ("SH 1, H.264, V³, [x](a-99.png), `--quality 99`, KhronosGroup/glTF#2573, Python 3.11", []),
    ("```sh\nairgs-encode --levels 99\n```\n<!-- 99 -->\n320 by 240", ["320", "240"]),
    ("| a | 13.84 | 0.0002 | 99.5 |", ["99.5"]),
    ("-0.0 dB off by 0.21 ‰", ["0.21"]),
])  # fmt: skip
def test_a_number_without_a_source_is_found(text, missing):
    assert published.unsourced(text, {"one": ENTRY}) == missing


def test_a_page_is_published_with_its_pictures_and_its_figures(tmp_path, monkeypatch):
    folder = tmp_path / "results"
    folder.mkdir()
    (tmp_path / "line.png").write_bytes(b"picture")
    marks = "<!-- tools.lab {0}: begin -->\n<!-- tools.lab {0}: end -->\n"
    text = "# A thing\n![A line](line.png)\n" + "".join(map(marks.format, ("thing", "other", "thing/brief+line")))
    (folder / "thing.md").write_text(text)
    (tmp_path / "README.md").write_text(marks.format("thing/brief"))
    thing = Measurement("thing", "thing", "thing")
    instead = {"RESULTS": folder, "README": tmp_path / "README.md", "FIGURES": folder / "figures.json"}
    for name, value in (instead | {"MEASUREMENTS": (thing,)}).items():
        monkeypatch.setattr(published, name, value)
    rows = [{"name": "a|b", "ms": 1.25, "ok": True, "more": 1}, {"name": "c", "ms": math.nan, "ok": False}]
    times = Table("times", rows, {"name": ("name", ""), "ms": ("ms", ".1f"), "ok": ("good", "")})
    brief = Table("brief", [{"name": "a", "ms": 1.25}], {"ms": ("time", ".2f")})
    line, dot = (PagePicture(name, f"A {name}", lambda figure: None) for name in ("line", "dot"))
    page = Page([Section("It takes 1 ms.", "How?", [line], [times]), Section("", "", [dot])], "By hand.", data=[brief])
    made = Made("thing", "How long?", "python -m tools.lab thing", "2 cores", 3.2, "2026-11-26", "abc1234", 4)
    (tmp_path / "dot.png").write_bytes(b"")
    published.publish(thing, page, made, tmp_path)
    assert "|time|\n|---:|\n|1.25|\n" in (tmp_path / "README.md").read_text()
    assert (folder / "line.png").read_bytes() == b"picture"
    text, said = (folder / "thing.md").read_text(), "Measured 2026-11-26, 3 s, commit abc1234, format 4, `thing`."
    assert (
        text.count(said) == 2 and "|1.25|\n\n![A line](line.png)\n\nMeasured" in text and "It takes 1 ms." not in text
    )
    entry = json.loads((folder / "figures.json").read_text())["thing"]
    assert entry["how"] == "By hand." and entry["pictures"] == ["line", "dot"]
    assert entry["tables"]["times"] == {
        "columns": ["name", "ms", "ok", "more"], "shown as": {"name": "name", "ms": "ms", "ok": "good"},
        "rows": [["a|b", 1.25, True, 1], ["c", None, False, None]],
    }  # fmt: skip
    assert published.unsourced(text, {"thing": entry}) == []


def test_only_the_command_that_documents_show_is_published():
    for words in (["stiff", "--quick"], ["work-precision"], ["stiff", "--publish", "stiff", "--quick"]):
        with pytest.raises(ConfigError, match=r"expected the command that documents show, python -m tools\.lab stiff"):
            measurement_of("stiff", words)
    assert measurement_of("stiff", ["stiff", "--publish", "stiff", "-o", "a"]).name == "stiff"


def test_every_picture_of_the_documents_is_of_a_measurement_or_of_the_table_of_figures():
    assert len({one.file for one in FIGURES}) == len(FIGURES)
    for one in FIGURES:
        assert (REPOSITORY / one.file).is_file() and (REPOSITORY / one.document).is_file(), one
    measured = {f"docs/results/{name}.png" for entry in published.read_figures().values() for name in entry["pictures"]}
    there = {p.relative_to(REPOSITORY).as_posix() for p in (REPOSITORY / "docs").rglob("*") if p.is_file()}
    made = {one.file for one in FIGURES} | measured | {"docs/results/figures.json"}
    assert {file for file in there if not file.endswith(".md")} == made
    for command in {one.command for one in FIGURES} | {f"{PROGRAM} {one.words}" for one in MEASUREMENTS}:
        assert command.startswith("(") or command_error(shlex.split(command), whole=True) is None, command


def curve(*pairs):
    return [RdPoint("c", str(i), kb, psnr, None, 0.0, 0.0) for i, (kb, psnr) in enumerate(pairs)]


WIDE = curve((10, 38), (14, 41), (20, 44), (28, 47), (40, 50))
HALF = curve((5, 38), (7, 41), (10, 44), (14, 47), (20, 50))
ABOVE = curve((10, 60), (20, 62), (30, 64), (40, 66))


@pytest.mark.parametrize(("points", "against", "span", "rate"), [
    (WIDE, WIDE, (), 0.0),
    (HALF, WIDE, (), -0.5),
    (WIDE, HALF, (41, 46), 1.0),
    (WIDE, [*WIDE, *curve((30, 40))], (), 0.0),  # what is beaten at fewer bytes does not count
    (WIDE, ABOVE, (), None),  # it never extrapolates
    (WIDE, WIDE, (60, 70), None),
    (WIDE, WIDE[:3], (), None),  # four points are needed
])  # fmt: skip
def test_rates_and_bytes_of_known_curves_lie_between_their_points(points, against, span, rate):
    assert bd_rate(points, against, *span) == (rate if rate is None else pytest.approx(rate))
    assert [kb_at(WIDE, 44), kb_at(WIDE, 42.5)] == pytest.approx([20, (14 * 20) ** 0.5])
    assert kb_at(WIDE, 37) is None is kb_at(WIDE[:1], 38)
