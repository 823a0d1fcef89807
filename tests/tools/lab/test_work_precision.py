"""The report on error against run time: what is good enough follows from rows, and a page is made again of its CSV."""

import csv
import dataclasses
import math
from dataclasses import asdict
from functools import partial

import numpy as np
import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.play.ladder import Option
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.named import make_policy
from tests.support.paths import FOX, REPOSITORY, VALID
from tools.lab import main
from tools.lab.command import Lab
from tools.lab.numerics import decode, encode, renderer, selector, survey, work_precision
from tools.lab.numerics.panels import NAMES, PARTS
from tools.lab.numerics.rows import Bench, Place, Row, open_scene, quartiles, read_row
from tools.lab.numerics.work_precision import Options, advice, figure, judge, page, run, seconds
from tools.lab.page import text_of, write_csv, write_picture
from tools.lab.paper.frames import paper_programme
from tools.lab.timing import Took

PANELS = {panel.name: (part.name, panel) for part in PARTS for panel in part.panels}


def row(panel, curve, setting, took, error, scene="fox"):
    return Row.of(Place(PANELS[panel][0], panel, scene, curve, str(setting)), [Took(took, 2 * took)], [error], "dB")


def said(*rows):
    panel = PANELS[rows[0].panel][1]
    return advice(panel, judge(panel, rows))


def test_the_cheapest_that_is_good_enough_is_advised_beside_the_default():
    fits = [row("frame", "direct", n, s, e) for n, s, e in ((100, 2.0, 33.2), (300, 5.0, 33.28))]
    assert said(*fits, row("frame", "mlp", 300, 7.0, 33.29)) == [
        "Frame in a group (fox): take `100` (direct); 2.5 times as long, the default, `300` (direct), is 0.08 dB "
        "better."
    ]
    (one,) = judge(PANELS["frame"][1], [*fits, row("frame", "mlp", 300, 7.0, 34.0)])
    assert (one.cheap.curve, one.best.curve) == ("mlp", "mlp") and one.cells()["best"] == "same"


def test_less_is_better_of_bytes_and_errors_and_scenes_that_agree_are_told_together():
    rows = [
        row("presets", curve, setting, took, error, scene)
        for scene in ("fox", "spinach")
        for curve, setting, took, error in ((encode.CALIBRATED, "veryslow", 8, 12.9), (encode.PLAIN, "medium", 3, 13.8))
    ]
    assert said(*rows) == ["Preset (fox, spinach): take `veryslow` (calibrated), the default."]
    assert said(*rows[:2])[0].startswith("Preset (fox)")


def test_what_cannot_be_chosen_decides_nothing():
    oracle, blind = row("policies qoe", "oracle-lp", "oracle-lp", 1e-3, 50.0), [
        row("policies qoe", name, name, took, 40.0) for name, took in (("robust-mpc", 1e-3), ("bola", 1e-5))
    ]  # fmt: skip
    assert said(oracle, *blind)[0].startswith("Policy (fox): take `bola`; 100 times as long, the default, `robust-mpc`")
    regret = [row("horizon", "robust-mpc", n, 1e-4 * n, n) for n in (1, 8)]
    assert said(*regret) == []  # regret alone decides nothing
    assert "Regret does not count waiting" in text_of(page([row("policies", "bola", "bola", 1.0, 1.0)]))


def test_only_pictures_of_one_size_are_compared():
    rows = [row("precision", "tiles", "80", 1e-3, 1e-5), row("precision", "tiles", "320", 6e-3, 2e-5)]
    (one,) = judge(PANELS["precision"][1], [*rows, row("precision", "definition", "320", 200.0, 0.0)])
    assert (one.cheap, one.name(one.cheap)) == (rows[1], "tiles")


def test_a_row_has_quartiles_and_survives_its_csv(tmp_path):
    assert quartiles([1.0, 2.0, 3.0, 4.0, 5.0]) == (3.0, 2.0, 4.0)
    kept = Row.of(Place("decode", "rungs", "fox", "levels", "L0"), [Took(2.0, 3.0), Took(4.0, 5.0)], [])
    assert (kept.seconds, kept.wall, kept.runs) == (3.0, 4.0, 2) and math.isnan(kept.error)
    write_csv([asdict(kept)], tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open() as file:
        (again,) = map(read_row, csv.DictReader(file))
    assert repr(again) == repr(kept)


@pytest.mark.parametrize(
    ("value", "words"), [(0.0, "0"), (3.14159, "3.14"), (1234.5, "1,230"), (2e-5, "2.0e-5"), (0.0015, "0.0015")]
)
def test_figures_have_three_digits(value, words):
    assert figure(value) == words


def test_times_have_units():
    assert [seconds(v) for v in (12.0, 1.5e-3, 2e-6)] == ["12 s", "1.5 ms", "2 µs"]


def test_the_page_of_the_documents_is_that_of_its_csv(tmp_path):
    made = run(Options(rows=REPOSITORY / "docs" / "results" / "work_precision.csv"), Lab.at(tmp_path, quiet=True))
    text = (REPOSITORY / "docs" / "results" / "work_precision.md").read_text()
    assert len(made.sections) == len(NAMES) + 1
    for section in made.sections:
        assert all(line[2:100] in text.replace("\n ", "") for line in section.answer.split("\n") if line)
    bars = made.sections[2].pictures[0]
    write_picture(bars, tmp_path / "decode.png")
    assert 5_000 < (tmp_path / "decode.png").stat().st_size < 200_000


def test_kernels_with_other_constants_are_made_of_the_renderers_source(tmp_path):
    assert renderer.variant(tmp_path, "tiles", 8).TILE == 8
    coarse = renderer.variant(tmp_path, "cuts", 64)
    coefficients = [getattr(coarse, f"E{i}") for i in range(6)]
    darkest, brightest = (sum(float(e) * x**i for i, e in enumerate(coefficients)) ** 8 for x in (0, math.log(64)))
    assert darkest == pytest.approx(1 / 64, rel=1e-4) and brightest == pytest.approx(1, rel=1e-4)
    with pytest.raises(ConfigError, match="expected 'NOT THERE'"):
        renderer.replaced("source", {"NOT THERE": ""})


def test_bytes_are_interpolated_in_the_logarithm():
    assert encode.bytes_at(42.0, encode.Trial(41.0, 100), encode.Trial(43.0, 400)) == pytest.approx(200)


@pytest.fixture
def two_frames(tmp_path):
    """The fox, cut to two frames."""
    folder = tmp_path / "two"
    folder.mkdir()
    for name in ("000000.ply", "000001.ply", "transforms.json"):
        (folder / name).symlink_to(FOX / name)
    return folder


def test_a_part_runs_end_to_end_and_is_not_measured_twice(two_frames, tmp_path, monkeypatch):
    monkeypatch.setattr(decode, "FRAMES", 1)
    settings = dataclasses.replace(encode.ONE_RUNG, measure_pictures=0, decide_pictures=2, preset="ultrafast")
    monkeypatch.setattr(Bench, "ladder", lambda bench, scene: bench.package(scene, settings, "small"))
    options = Options(f"fox={two_frames}", only=("decode",), quick=True)
    made = run(options, Lab.at(tmp_path, quiet=True))
    assert "Stages (fox): " in text_of(made)
    measured = (tmp_path / "work_precision.csv").read_text()
    run(options, Lab.at(tmp_path, quiet=True))
    assert (tmp_path / "work_precision.csv").read_text() == measured  # times and all


def test_pictures_of_a_trial_are_drawn_as_its_curve_says(two_frames, tmp_path):
    settings = dataclasses.replace(encode.ONE_RUNG, measure_pictures=0, decide_pictures=2, preset="ultrafast")
    scene = open_scene(f"fox={two_frames}")
    subject = survey.Subject(scene, Bench((scene,), tmp_path).package(scene, settings, "small"), 1)
    cameras = {curve: next(survey.draws(subject, curve, 4, 1)) for curve in (survey.APART, survey.ONE_VIEW)}
    assert len({camera.name for _, camera in cameras[survey.APART]}) == 4
    assert len({camera.name for _, camera in cameras[survey.ONE_VIEW]}) == 1
    assert len({n for n, _ in next(survey.draws(subject, survey.ONE_FRAME, 4, 1))}) == 1


def test_sessions_give_regret_and_what_it_leaves_out():
    links = selector.Links(Offers.of(open_package(VALID / "moving")), 2)
    place = Place("selector", "policies", "moving", "throughput", "throughput")
    regret, qoe = selector._sessions(links, place, partial(make_policy, "throughput", links.offers))
    assert (regret.panel, qoe.panel) == ("policies", "policies qoe") and regret.error >= 0 and qoe.unit == "dB of QoE"
    assert regret.runs == qoe.runs > 2 and {regret.panel, qoe.panel} <= set(PANELS)


def test_denser_levels_lose_less_and_the_programme_has_what_the_search_has():
    sizes, quality = selector.dense_levels([[Option(0, 1000, 40.0, 0.0), Option(1, 100, 30.0, 0.9)]], 8)
    assert sizes.shape == (selector.FRAMES, 8) and (np.diff(sizes[0]) < 0).all() and (np.diff(quality[0]) < 0).all()
    budgets = np.linspace(150, 900, len(sizes))
    shares, _ = paper_programme(sizes, quality, budgets)
    best, found = selector.best_possible(sizes, quality, budgets), selector.greedy(sizes, quality, budgets)
    assert (shares * quality).sum() / len(sizes) == pytest.approx(found)
    assert selector.relaxed(sizes, quality, budgets) <= found < best < found + 10 / 7


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scene", "fox"], "expected NAME=FOLDER"),
        (["--scene", "fox=/nowhere"], "nowhere"),
        (["--only", "encode", "nothing"], "got nothing"),
    ],
)
def test_bad_input_is_one_line(tmp_path, words, message, capsys):
    assert main(["work-precision", "-o", str(tmp_path), *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_every_part_has_a_name_and_panels_of_their_own():
    assert len(PANELS) == sum(len(part.panels) for part in PARTS) and len(set(NAMES)) == len(NAMES)
    assert work_precision.PARTS is PARTS
