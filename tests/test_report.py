"""Reports: text tables, figures and pages; the page of an encode shows what came out and says what it concludes."""

import itertools
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airgs_codec._report import Page, PagePicture, Table, answered, listed
from airgs_codec.encoder.plan import Choice
from airgs_codec.inspect.report import advice, write_report
from tests import faces
from tests.faces import ConfigError
from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID
from tests.support.regions import region
from tests.support.scenes import moving_frames
from tests.support.views import moved
from tools.lab import plain_log_ticks


def test_a_table_is_the_same_rows_as_text_and_as_html_and_long_lists_of_names_are_cut():
    rows = [{"a": 1000, "b": 0.25, "c": "<b>"}, {"a": 7, "b": math.nan, "c": True}]
    table = Table("some", rows, {"a": ("a", ""), "b": ("long", ".0%"), "c": ("c", lambda value: f"{value}!")})
    assert table.to_text().split("\n") == ["    a  long      c", "1,000  25 %   <b>!", "    7     -  True!"]
    assert "<td>1,000</td><td>25 %</td><td>&lt;b&gt;!</td>" in table.to_html()
    assert Table("all", [{"frame_s": 1.5}, {"other": False}]).lines() == [
        ["frame s", "other"],
        ["1.5", "-"],
        ["-", "no"],
    ]
    assert [listed(list("abc")[:most]) for most in (1, 2, 3)] == ["a", "a and b", "a, b and c"]
    assert listed(list("abcdefg")) == "a, b, c, d, e and 2 more"


def chart(caption):
    return PagePicture("", caption, lambda figure: figure.subplots().plot([0, 1]))


@pytest.mark.parametrize(("low", "high"), [(1, 1000), (12, 48), (0.31, 0.9), (5, 7), (1e-6, 1e6)])
def test_labels_of_a_log_axis_do_not_touch(low, high, tmp_path: Path):
    def draw(figure):
        axis = figure.subplots()
        axis.plot([low, high], [0, 1])
        axis.set_xscale("log")
        plain_log_ticks(axis.xaxis)
        drawn.append(axis)

    drawn = []
    PagePicture("", "", draw, (4, 2)).write(tmp_path / "log.png")
    labels = [text for text in drawn[0].get_xticklabels(which="both") if text.get_text()]
    boxes = sorted((t.get_window_extent() for t in labels), key=lambda box: box.x0)
    inside = [b for b in boxes if drawn[0].bbox.x0 <= (b.x0 + b.x1) / 2 <= drawn[0].bbox.x1]
    assert 3 <= len(inside) <= 6
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(inside))


def test_a_page_answers_first_then_shows_pictures_then_folds_its_tables(tmp_path):
    still = PagePicture("still.png", "still <1>", save=lambda path: path.write_bytes(b"still"))
    answer = {"good": "3 < 4 dB.", "wrong": "", "change": "Nothing."}
    tables = Table("All", [{"a": "<b>"}]), Table("None", [])
    page = Page(answered(answer, [chart("a chart"), still], *tables), "Of <it>", 15)
    text = page.write(tmp_path / "page").read_text()
    order = "Of &lt;it&gt;</h1>", "<h2>How good it is</h2><p>3 &lt; 4 dB.", "What to change", "data:image/svg"
    places = [text.index(part) for part in (*order, '<img src="still.png"', "<details>")]
    assert places == sorted(places) and 'name="viewport"' in text and 'content="15"' in text
    assert "went wrong" not in text and "still &lt;1&gt;" in text and "&lt;b&gt;" in text
    assert text.count("<details>") == 1 and text.count("<figure") == 2
    assert (tmp_path / "page" / "still.png").read_bytes() == b"still"
    with pytest.raises(ConfigError, match="cannot write the report"):
        page.write(tmp_path / "page" / "still.png")


PLAN = faces.decide(
    faces.GaussianSequence.from_arrays(moving_frames(20, 1)), faces.EncodeSettings(calibrate="none", region=region())
)
DONE = faces.EncodeReport(tiny_manifest(), 0, PLAN, faces.Restored(None), 6.0, 3.0)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The folder of a report on a package beside what it decodes to, but for a frame in which some rows are away."""
    package = faces.open_package(VALID / "moving")
    frames = [frame.gaussians for frame in faces.decode_frames(package, 0, 4)]
    frames[2] = moved(frames[2], slice(0, 12), (0.4, 0.2, 0.0))
    folder = tmp_path_factory.mktemp("report") / "made"
    sequence = faces.GaussianSequence.from_arrays(frames, fps=package.manifest.fps)
    write_report(folder, sequence, package, replace(DONE, manifest=package.manifest))
    return folder


def test_the_page_names_the_lowest_frame_and_shows_it_beside_the_given_one(page):
    text = (page / "index.html").read_text()
    assert "The lowest picture is of frame 2" in text and "far below the others" in text
    assert re.findall(r'<img src="([^":]+)"', text) == ["frame-000002.png"]
    assert faces.read_picture(page / "frame-000002.png").shape[1] > 3 * 300  # given, encoded, difference
    assert text.count("<figure") == 2
    assert re.search(r"is measured at [\d.]+ dB, good to [\d.]+ dB", text) and "What took the time" in text


def test_advice_follows_what_took_the_time_and_how_sure_the_claim_is():
    def took(about, **settings):
        plan = replace(PLAN, settings=replace(PLAN.settings, **settings), choices=(Choice(about, "", 60.0),))
        return replace(DONE, plan=plan)

    def sure(error):
        rungs = [[replace(rung, error=error) for rung in of_quality] for of_quality in DONE.manifest.rungs]
        return replace(DONE, measure_s=60.0, manifest=replace(DONE.manifest, rungs=rungs))

    assert advice(DONE) == ""
    assert "Fewer --measure-pictures" in advice(sure(0.1))
    few = replace(PLAN, settings=replace(PLAN.settings, measure_pictures=8))
    assert "more --measure-pictures" in advice(replace(sure(0.8), plan=few))
    assert "--calibrate none" in advice(took("steps and pruning levels"))
    assert "--quality 1.3 " in advice(took("quality", quality=1.3))
    weighed = replace(PLAN.settings.steps, colours=tuple(np.eye(3).ravel().tolist()))
    assert advice(took("quality", steps=weighed)) == ""  # a factor alone does not give it again
