"""The laboratory's own mechanism: options, the store of results, the page, the tables of experiments and figures."""

import importlib
import json
import math
import multiprocessing
import shlex
import time
from dataclasses import dataclass, fields
from pathlib import Path

import pytest

from airgs_codec.errors import ConfigError
from tests.support.paths import REPOSITORY
from tools.lab import main, published, required, setting
from tools.lab.command import PROGRAM
from tools.lab.experiments import EXPERIMENTS, FIGURES, MEASUREMENTS
from tools.lab.page import Made, Page, Picture, Section, Table, body_of, markdown, update, write_page
from tools.lab.results import Results, content
from tools.lab.timing import alone, middle, seconds_of, timed

MADE = Made("thing", "How long?", "python -m tools.lab thing", "2 cores", 3.2, "2026-11-26", "abc1234", 4)


@dataclass(frozen=True, slots=True)
class Things:
    scene: Path = required("a scene")
    counts: tuple[int, ...] = setting((1, 2), "how many")
    share: float | None = setting(None, "in %")
    quick: bool = setting(False, "be quick")
    note_text: str = setting("", "a note")


def test_a_result_is_made_once_for_what_it_reads(tmp_path):
    made = []
    results = Results.at(tmp_path)

    def make():
        made.append(len(made))
        return {"value": math.nan, "number": made[-1]}

    assert [results.once("a", reads, make)["number"] for reads in ((1, "x"), (1, "x"), (2, "x"), (1, "x"))] == [
        0, 0, 1, 0,
    ]  # fmt: skip
    assert Results.at(tmp_path).once("a", (1, "x"), make)["number"] == 0
    assert results.once("b", (1, "x"), make)["number"] == 2
    with pytest.raises(TypeError):
        results.once("a", object(), make)


def test_a_result_that_failed_is_not_kept(tmp_path):
    results = Results.at(tmp_path)
    with pytest.raises(ZeroDivisionError):
        results.once("a", 1, lambda: 1 / 0)
    assert results.once("a", 1, lambda: 5) == 5


def test_content_is_that_of_files_and_their_names(tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    for folder in (one, other):
        folder.mkdir()
        (folder / "a").write_text("x")
    assert content(one) == content(other) != content(one / "a")
    (other / "a").rename(other / "b")
    assert content(one) != content(other)


def page(failed=False):
    rows = [{"name": "a|b", "ms": 1.25, "ok": True, "more": 1}, {"name": "c", "ms": math.nan, "ok": False}]
    table = Table("times", rows, {"name": ("name", ""), "ms": ("ms", ".1f"), "ok": ("good", "")})
    picture = Picture("line", "A line", lambda figure: figure.subplots().plot([1, 2]), (2, 1))
    return Page(
        [Section("It takes 1 ms.", "How long?", [picture], [table]), Section("No.", "More?")], "By hand.", failed
    )


def test_a_page_is_markdown_with_everything_beside_it(tmp_path):
    write_page(page(), MADE, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["line.png", "thing.json", "thing.md"]
    text = (tmp_path / "thing.md").read_text()
    assert text == markdown(page(), MADE)
    for line in ("# How long?", "By hand.", "## More?", "![A line](line.png)", "|name|ms|good|", "|c|-|no|"):
        assert f"\n{line}\n" in f"\n{text}"
    found = json.loads((tmp_path / "thing.json").read_text())
    assert found["figures"]["times"][1]["ms"] is None and found["machine"] == "2 cores"


def test_a_page_goes_between_its_marks(tmp_path):
    document = tmp_path / "document.md"
    document.write_text("# A\n\n<!-- tools.lab thing: begin -->\nold\n<!-- tools.lab thing: end -->\n\n## B\n")
    update(document, "thing", body_of(page(), MADE))
    text = document.read_text()
    assert text.startswith("# A\n\n<!-- tools.lab thing: begin -->\n\nBy hand.") and "old" not in text
    assert text.endswith("<!-- tools.lab thing: end -->\n\n## B\n")
    with pytest.raises(ConfigError, match="other: begin"):
        update(document, "other", "")


def test_work_is_timed_here_and_alone():
    took, value = seconds_of(lambda: 3)
    assert value == 3 and took.cpu >= 0 and took.times(2).wall == 2 * took.wall
    assert len(timed(lambda: None, 3)) == 3 and middle([took, took]) == took
    measured, value = alone(math.gcd, 6, 4)
    assert value == 2 and 1 < measured.peak_mb < 4000


def test_work_that_takes_too_long_is_ended():
    with pytest.raises(TimeoutError):
        alone(time.sleep, 600, limit_s=0.1)
    assert not multiprocessing.active_children()


def test_every_experiment_is_there_and_can_be_asked_for_help(capsys):
    assert len({one.name for one in EXPERIMENTS}) == len(EXPERIMENTS)
    assert main([]) == 0
    listed = capsys.readouterr().out
    for one in EXPERIMENTS:
        module = importlib.import_module(one.module)
        assert one.name in listed and one.question.endswith("?") and module.__doc__ and callable(module.run)
        assert all("help" in f.metadata for f in fields(module.Options))
        assert main([one.name, "--help"]) == 0
        assert module.__doc__.splitlines()[0] in " ".join(capsys.readouterr().out.split())


def test_an_experiment_that_found_what_must_not_be_ends_with_status_1(tmp_path, monkeypatch, capsys):
    module = importlib.import_module(EXPERIMENTS[0].module)
    monkeypatch.setattr(module, "Options", Things)
    monkeypatch.setattr(module, "run", lambda options, lab: page(failed=True))
    assert main([EXPERIMENTS[0].name, "scene", "-o", str(tmp_path)]) == 1
    assert EXPERIMENTS[0].question in (tmp_path / f"{EXPERIMENTS[0].name}.md").read_text()


def test_bad_input_is_one_line(tmp_path, monkeypatch, capsys):
    module = importlib.import_module(EXPERIMENTS[0].module)

    def refuse(options, lab):
        raise ConfigError("scene: expected a scene")

    monkeypatch.setattr(module, "Options", Things)
    monkeypatch.setattr(module, "run", refuse)
    assert main([EXPERIMENTS[0].name, "scene", "-o", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"lab {EXPERIMENTS[0].name}: scene: expected a scene\n"


def test_every_picture_of_the_documents_is_of_a_measurement_or_of_the_table_of_figures():
    assert len({one.file for one in FIGURES}) == len(FIGURES)
    for one in FIGURES:
        assert (REPOSITORY / one.file).is_file() and (REPOSITORY / one.document).is_file(), one
    measured = {f"docs/results/{name}.png" for entry in published.read_figures().values() for name in entry["pictures"]}
    there = {p.relative_to(REPOSITORY).as_posix() for p in (REPOSITORY / "docs").rglob("*") if p.is_file()}
    made = {one.file for one in FIGURES} | measured | {"docs/results/figures.json"}
    assert {file for file in there if not file.endswith(".md")} == made


def test_commands_of_the_table_of_figures_are_commands():
    from tools.check_docs import command_error

    for command in {one.command for one in FIGURES} | {f"{PROGRAM} {one.words}" for one in MEASUREMENTS}:
        if not command.startswith("("):
            assert command_error(shlex.split(command), whole=True) is None, command
