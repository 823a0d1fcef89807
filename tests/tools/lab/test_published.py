"""What is published comes from one file of figures: a number of README or docs/results that it lacks is found."""

import json
import math
import shlex
from dataclasses import replace

import pytest

from tests.faces import ConfigError
from tests.support.paths import REPOSITORY
from tools.check_docs import command_error
from tools.lab import Page, PagePicture, Section, Table, published
from tools.lab.command import PROGRAM, measurement_of
from tools.lab.experiments import FIGURES, MEASUREMENTS, NO_LONGER_MEASURED, Measurement
from tools.lab.page import Made
from tools.lab.rd.subject import RdPoint, bd_rate, kb_at

PAGES = sorted(published.RESULTS.glob("*.md"))
ENTRY = {
    "command": "airgs-encode --levels 7", "answers": ["It takes 1.5 s, 4 of 9."], "seconds": 81.2,
    "tables": {"a": {"columns": ["kb", "share"], "rows": [[13.84, 0.2571], [1236.4, -0.000213]]}},
}  # fmt: skip


def own(name):
    """The entries of a page; README and the first page of results show those of all."""
    entries = published.read_figures()
    return entries if name == "README" else {key: one for key, one in entries.items() if one["document"] == name}


@pytest.mark.parametrize("path", [REPOSITORY / "README.md", *PAGES], ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_every_number_of_results_is_in_the_file_of_figures(path):
    assert published.unsourced(path.read_text(), own(path.stem)) == []


def test_the_first_page_shows_an_answer_of_every_page_that_has_one():
    entries = published.read_figures()
    table = published.answers_of(entries)
    assert published.markdown_table(table) in (published.RESULTS / "README.md").read_text()
    told = {one["question"].partition("](")[2].removesuffix(".md)"): one["answer"] for one in table.rows}
    assert told.keys() == {path.stem for path in PAGES} - {"README"}
    assert all(told[one["document"]] for one in entries.values() if one["answers"] and one["document"] != "README")


def test_every_measurement_has_its_place_in_a_document_and_every_entry_is_made_by_its_command():
    entries = published.read_figures()
    commands = {one.name: (one.document, f"{PROGRAM} {one.words}") for one in MEASUREMENTS}
    assert len(commands) == len(MEASUREMENTS)
    for name, (document, _) in commands.items():
        text = (published.RESULTS / f"{document}.md").read_text()
        assert [text.count(f"<!-- tools.lab {name}: {word} -->\n") for word in ("begin", "end")] == [1, 1], name
    made = {name: (one["document"], one["command"]) for name, one in entries.items() if name not in NO_LONGER_MEASURED}
    assert made.items() <= commands.items()
    assert set(NO_LONGER_MEASURED) <= set(entries) and not set(NO_LONGER_MEASURED) & set(commands)
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
    (folder / "thing.md").write_text("# A thing\n" + marks.format("thing") + marks.format("second"))
    (folder / "README.md").write_text(marks.format("answers"))
    (tmp_path / "README.md").write_text(marks.format("thing"))
    thing = Measurement("thing", "thing", "thing")
    instead = {"RESULTS": folder, "README": tmp_path / "README.md", "FIGURES": folder / "figures.json"}
    for name, value in (instead | {"MEASUREMENTS": (thing,)}).items():
        monkeypatch.setattr(published, name, value)
    rows = [{"name": "a|b", "ms": 1.25, "ok": True, "more": 1}, {"name": "c", "ms": math.nan, "ok": False}]
    times = Table("times", rows, {"name": ("name", ""), "ms": ("ms", ".1f"), "ok": ("good", "")})
    brief = Table("brief", [{"name": "a", "ms": 1.25}], {"ms": ("time", ".2f")})
    section = Section("It takes 1 ms.", "How long?", [PagePicture("line", "A line", lambda figure: None)], [times])
    page = Page([section, Section("No.", "More?")], "By hand.", brief=[brief])
    made = Made("thing", "How long?", "python -m tools.lab thing", "2 cores", 3.2, "2026-11-26", "abc1234", 4)
    published.publish(thing, page, made, tmp_path)
    assert "|time|\n|---:|\n|1.25|\n" in (tmp_path / "README.md").read_text()
    assert "|[A thing](thing.md)|It takes 1 ms.|" in (folder / "README.md").read_text()
    assert (folder / "line.png").read_bytes() == b"picture"
    text = (folder / "thing.md").read_text()
    assert "It takes 1 ms." in text and "Measured 2026-11-26 in 3 s, commit abc1234, format 4." in text
    entry = json.loads((folder / "figures.json").read_text())["thing"]
    assert entry["tables"]["times"] == {
        "columns": ["name", "ms", "ok", "more"], "shown as": {"name": "name", "ms": "ms", "ok": "good"},
        "rows": [["a|b", 1.25, True, 1], ["c", None, False, None]],
    }  # fmt: skip
    assert published.unsourced(text, {"thing": entry}) == []
    published.publish(Measurement("second", "thing", "second"), page, replace(made, name="second"), tmp_path)
    assert (tmp_path / "README.md").read_text().count("|time|") == 1  # where README has no marks it shows nothing
    with pytest.raises(ConfigError, match="other: begin"):
        published.publish(Measurement("other", "thing", "other"), page, replace(made, name="other"), tmp_path)


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
