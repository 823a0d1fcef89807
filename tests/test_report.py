"""Text tables, and figures where matplotlib is and where it is not."""

import itertools
import re
import sys
from pathlib import Path

import pytest

from airgs_codec._report import Page, Picture, html_table, listed, new_figure, plain_log_ticks, save_figure, table
from tests.faces import ConfigError, airgs_manifest, airgs_play, airgs_train


def test_columns_are_right_aligned_and_long_lists_of_names_cut():
    assert table(["a", "long"], [["1000", "2"]]) == ["   a  long", "1000     2"]
    assert [listed(list("abc")[:most]) for most in (1, 2, 3)] == ["a", "a and b", "a, b and c"]
    assert listed(list("abcdefg")) == "a, b, c, d, e and 2 more"


WITH_PICTURES = {
    "none --trace const:1 --policy fixed:0 --report": airgs_play, "inspect none --plot": airgs_manifest,
    "none -o out --report": airgs_train,
}  # fmt: skip


@pytest.mark.parametrize("words", WITH_PICTURES)
def test_without_matplotlib_pictures_are_refused_before_the_work(words, tmp_path, monkeypatch, capsys):
    """What is looked at does not exist here: what is refused first must be the picture."""
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.chdir(tmp_path)
    assert WITH_PICTURES[words]([*words.split(), "picture.png"]) == 2
    error = capsys.readouterr().err
    assert f"{words.split()[-1]} needs matplotlib: pip install 'airgs-codec[plot]'" in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
    with pytest.raises(ConfigError, match="a picture needs matplotlib"):
        new_figure(1, 1)


def test_a_picture_that_cannot_be_written(tmp_path):
    figure = new_figure(1, 1)
    for path, words in (("none/a.png", "cannot write the picture"), ("a.unknown", "a name that ends in .avif")):
        with pytest.raises(ConfigError, match=words):
            save_figure(figure, tmp_path / path)


@pytest.mark.parametrize(("low", "high"), [(1, 1000), (12, 48), (0.31, 0.9), (5, 7), (1e-6, 1e6)])
def test_labels_of_a_log_axis_do_not_touch(low, high, tmp_path: Path):
    figure = new_figure(4, 2)
    axis = figure.subplots()
    axis.plot([low, high], [0, 1])
    axis.set_xscale("log")
    plain_log_ticks(axis.xaxis)
    save_figure(figure, tmp_path / "log.png")
    labels = [text for text in axis.get_xticklabels(which="both") if text.get_text()]
    boxes = sorted((t.get_window_extent() for t in labels), key=lambda box: box.x0)
    inside = [b for b in boxes if axis.bbox.x0 <= (b.x0 + b.x1) / 2 <= axis.bbox.x1]
    assert 3 <= len(inside) <= 6
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(boxes))


def test_a_page_answers_first_then_shows_at_most_four_pictures_then_folds_its_tables():
    picture = Picture("one", name="one.png")
    shown = Picture("a chart", lambda axis: axis.plot([0, 1])), Picture("film <1>", name="film.mp4"), picture, picture
    told = {"good": "3 < 4 dB.", "wrong": "", "change": "Nothing."}
    text = Page("Of <it>", told, shown, {"All": html_table([("a", "<b>")]), "None": html_table([])}).to_html()
    order = ["Of &lt;it&gt;</h1>", "<dt>How good it is</dt><dd>3 &lt; 4 dB.", "What to change", "<svg", "<video"]
    places = [text.index(part) for part in [*order, "<details>"]]
    assert places == sorted(places) and 'name="viewport"' in text
    assert "went wrong" not in text and "film &lt;1&gt;" in text and "&lt;b&gt;" in text
    assert text.count('<img src="one.png" alt="one">') == 2
    assert text.count("<details>") == 1 and text.count("<figure") == 4
    with pytest.raises(AssertionError, match="everything"):
        Page("", {}, [*shown, picture], {}).to_html()


def test_no_id_of_charts_stands_twice_on_a_page_and_every_reference_has_its_own():
    charts = [Picture(f"{n}", lambda axes: axes.plot([1, 2], [3, 4], label="a") and axes.legend()) for n in range(3)]
    text = Page("", {}, charts, {}).to_html()
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids)) > 30
    used = set(re.findall(r'(?:href="|url\()#([^")]+)[")]', text))
    assert used <= set(ids) and len(used) > 10


def test_panels_beside_each_other_are_shown_one_by_one():
    text = Picture("three", name="a.png", panels=3, shape=(100, 600, 3)).to_html(0)
    assert text.count('src="a.png"') == 3 and text.count("aspect-ratio:200/100") == 3
    assert [text.count(f"object-position:{share}% 0") for share in (0, 50, 100)] == [1, 1, 1]
