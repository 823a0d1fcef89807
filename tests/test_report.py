"""Reports: text tables, figures and pages; the page of an encode shows what came out and says what it concludes."""

import html
import itertools
import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from airgs_codec._report import Page, Picture, html_table, listed, new_figure, plain_log_ticks, save_figure, table
from airgs_codec.inspect.report import advice, bought, holds_back, write_report
from tests import faces
from tests.faces import ConfigError, Goal, airgs_manifest, airgs_play, airgs_train
from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID
from tests.support.views import moved


def test_columns_are_right_aligned_and_long_lists_of_names_cut():
    assert table(["a", "long"], [["1000", "2"]]) == ["   a  long", "1000     2"]
    assert [listed(list("abc")[:most]) for most in (1, 2, 3)] == ["a", "a and b", "a, b and c"]
    assert listed(list("abcdefg")) == "a, b, c, d, e and 2 more"


@pytest.mark.parametrize(("main", "words"), [
    (airgs_play, "none --trace const:1 --policy fixed:0 --report"), (airgs_manifest, "inspect none --plot"),
    (airgs_train, "none -o out --report"),
])  # fmt: skip
def test_without_matplotlib_pictures_are_refused_before_the_work(main, words, tmp_path, monkeypatch, capsys):
    """What is looked at does not exist here: what is refused first must be the picture."""
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.chdir(tmp_path)
    assert main([*words.split(), "picture.png"]) == 2
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


SECONDS = (0.1, 2.0, 3.0, 0.0, 6.0, 3.0)
DONE = faces.EncodeReport(tiny_manifest(), 0, faces.Restored(None), *SECONDS, cached=False, uncertainty=0.03)


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


def test_the_page_names_the_worst_frame_and_shows_it_and_a_film_of_both_sides(page):
    text = (page / "index.html").read_text()
    assert "Frame 2 is the worst" in text and "far below the others" in text
    assert set(re.findall(r'<img src="([^"]+)"', text)) == {"frame-000002.png"}
    assert faces.read_picture(page / "frame-000002.png").shape[1] > 3 * 300  # given, encoded, difference
    film = faces.VideoReader(page / "film.mp4")
    width, height = film.size
    assert len(film.clock.pictures) == 4 and width > height  # two pictures beside each other
    assert set(re.findall(r'(?:src|href)="([^"#]+)"', text)) <= {path.name for path in page.iterdir()}
    assert text.count("<figure") == 4 and html.escape(bought(DONE.stages())).split(".")[0] in text


def test_keys_or_states_hold_it_back_whichever_costs_more_of_a_kilobyte():
    known = [rung for rung in faces.summarise(tiny_manifest(), 0).rungs if rung.state != "L2"]

    def words(*psnr):
        """Of Q0+L0, Q0+L1, Q1+L0 and Q1+L1, which cost 12, 11, 10 and 9 kB a frame."""
        return holds_back([replace(known[i], bytes_per_frame=1e3 * (12 - i), psnr=db) for i, db in enumerate(psnr)])

    states, keys = words(44.0, 40.0, 42.0, 39.0), words(44.0, 43.0, 38.0, 37.0)
    assert states.startswith("Its states hold it back") and "costs 4.0 dB, of its keys 1.0 dB" in states
    assert keys.startswith("Its keys hold it back") and "costs 3.0 dB, of its states 1.0 dB" in keys
    assert words(None, None, None, None) == words(44.0, 43.0) == ""


def test_what_each_second_bought_begins_with_what_took_longest():
    told = bought(DONE.stages())
    assert told.startswith("14 s in all. Encoding took 6.0 s: the package, at the first attempt.")
    assert "Order of rows" not in told and "Calibration took 3.0 s: nothing" in told
    assert "good to 0.3 dB" in told
    top = DONE.manifest.bytes_of(DONE.manifest.rung_files(0, 0)) / DONE.manifest.frames
    trials = ((1.0, 42.0), (1.3, 40.05), (1.2, 41.0))
    found = replace(DONE, search_s=12.0, goal=Goal(faces.PSNR, 40.0), trials=trials)
    more = replace(found, saved=top / 3, cached=True, repairs=("L1",))
    told = bought(more.stages())
    assert "Search took 12.0 s: 3 trials for 40 PSNR, from 42 to 41. Encoding took 6.0 s: L1." in told
    assert "save about 25 % of the bytes at equal error, which an earlier run found" in told
    assert "--quality 1.3 " in advice(more)
    colours = replace(more, goal=Goal(faces.DELTA_E, 0.5), trials=((1.0, 0.6), (0.8, 0.5)))
    assert "3 trials" not in bought(colours.stages()) and advice(colours) == ""  # a factor alone does not give it again


def test_advice_follows_what_took_the_time_and_how_sure_the_claim_is():
    assert advice(DONE) == ""
    assert "Fewer --measure-pictures" in advice(replace(DONE, measure_s=60.0))
    for uncertainty in (0.2, math.inf):  # infinite: of one picture
        assert "more --measure-pictures" in advice(replace(DONE, measure_s=60.0, uncertainty=uncertainty))
    assert faces.certainty_words(math.inf).startswith("of a single picture")
    assert "--calibrate none" in advice(replace(DONE, calibrate_s=60.0))
