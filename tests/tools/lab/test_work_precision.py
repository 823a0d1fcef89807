"""The report on error against run time: what is good enough follows from rows."""

import dataclasses
import itertools
from functools import partial

import pytest

from airgs_codec._report import new_figure
from airgs_codec.package.package import open_package
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.named import make_policy
from airgs_codec.play.trace import markov_trace
from tests.support.paths import FOX, VALID
from tools.lab import main, published
from tools.lab.command import Lab
from tools.lab.numerics import encode, selector, survey, work_precision
from tools.lab.numerics.rows import Bench, Place, Row, average, open_scene, quartiles
from tools.lab.numerics.work_precision import NAMES, QUESTIONS, Options, answer, figure, judge, page, run, seconds
from tools.lab.page import text_of, write_picture
from tools.lab.timing import Took

BY_NAME = {question.name: question for question in QUESTIONS}


def row(question, curve, setting, took, error, scene="fox", note=""):
    return Row.by(Place(question, scene, curve, str(setting)), [Took(took, 2 * took)], quartiles([error]), "dB", note)


def said(*rows):
    question = BY_NAME[rows[0].question]
    return answer(question, judge(question, rows))


def test_the_cheapest_that_is_good_enough_is_advised_with_what_less_and_more_time_give():
    fits = [row("trainer", "direct", n, s, e) for n, s, e in ((30, 1.0, 32.0), (100, 2.0, 33.2), (300, 5.0, 33.28))]
    assert said(*fits, row("trainer", "mlp", 300, 7.0, 33.29)) == (
        "Take `100` (direct): fox 33.2 dB PSNR of held-out cameras in 2 s. Fox: 0.5 of the time (`30` (direct)) costs "
        "1.2 dB; 3.5 times the time (`300` (mlp)) gains 0.09 dB; the default, `300` (direct), is 0.08 dB better in 2.5 "
        "times the time."
    )
    better = said(*fits, row("trainer", "mlp", 300, 7.0, 34.0))
    assert better.startswith("Take `300` (mlp)") and "the default, `300` (direct), is 0.72 dB worse" in better
    worse = said(*fits[:2], row("trainer", "direct", 300, 5.0, 33.1))
    assert "more time gains nothing" in worse and "is 0.1 dB worse in 2.5 times the time" in worse


def test_less_is_better_of_bytes_and_errors_and_scenes_that_agree_are_told_together():
    rows = [
        row("encode", curve, setting, took, error, scene)
        for scene in ("fox", "spinach")
        for curve, setting, took, error in ((encode.CALIBRATED, "veryslow", 8, 12.9), (encode.PLAIN, "medium", 3, 13.8))
    ]
    assert said(*rows) == (
        "Take `veryslow` (calibrated), the default: fox 12.9 kB a frame at 43 dB in 8 s; spinach 12.9 kB a frame at 43 "
        "dB in 8 s. Fox: 0.375 of the time (`medium` (default steps)) costs 0.9 kB. Spinach: 0.375 of the time "
        "(`medium` (default steps)) costs 0.9 kB."
    )
    assert said(*rows[:2], row("encode", encode.PLAIN, "medium", 3, 12.8, "spinach"), rows[2]).count("Take") == 2


def test_what_cannot_be_chosen_decides_nothing_and_waiting_is_told():
    oracle, blind = row("policies", "policies", "oracle-lp", 1e-3, 50.0), [
        row("policies", "policies", name, took, 40.0, note=f"{wait} % waiting")
        for name, took, wait in (("robust-mpc", 1e-3, 3), ("bola", 1e-5, 5))
    ]  # fmt: skip
    words = said(oracle, *blind)
    assert words.startswith("Take `bola`: fox 40 dB of QoE in 10 µs, 5 % waiting.")
    assert "the default, `robust-mpc`, is 0 dB worse in 100 times the time, 3 % waiting" in words


def test_why_a_default_stays_is_said_only_where_it_is_not_the_answer():
    apart = [row("claims", survey.APART, 32, 1.0, 0.1), row("claims", survey.OWN, 5, 2.0, 0.15)]
    assert "The default stays: it looks again" in said(*apart)
    assert "The default stays" not in said(apart[0], row("claims", survey.OWN, 5, 0.5, 0.1))


def test_only_pictures_of_one_size_are_compared():
    rows = [row("renderer", "tiles", "80", 1e-3, 1e-5), row("renderer", "tiles", "320", 6e-3, 2e-5)]
    (one,) = judge(BY_NAME["renderer"], [*rows, row("renderer", "definition", "320", 200.0, 0.0)])
    assert (one.cheap, one.name(one.cheap)) == (rows[1], "tiles")


def test_a_row_has_quartiles():
    assert quartiles([1.0, 2.0, 3.0, 4.0, 5.0]) == (3.0, 2.0, 4.0)
    kept = Row.of(Place("decode", "fox", "levels", "L0"), [Took(2.0, 3.0), Took(4.0, 5.0)], [1.0, 2.0, 4.0], "dB")
    assert (kept.seconds, kept.wall, kept.runs, kept.error) == (3.0, 4.0, 2, 2.0)


def test_sessions_have_a_mean_that_a_few_that_wait_long_move():
    assert average([4.0]) == (4.0, 4.0, 4.0)
    assert average([44.0, 44.0, 44.0, 20.0]) == pytest.approx((38.0, 32.0, 44.0))


def test_labels_of_points_that_lie_together_do_not_overlap(tmp_path):
    rows = [row("horizon", "horizon", n, 1e-3 * (1 + 1e-3 * n), 44 + 1e-3 * n, note="2.2 % waiting") for n in range(6)]
    shown = new_figure(6, 3.7)
    work_precision.draw(BY_NAME["horizon"], [*rows, row("horizon", "horizon", "far", 9e-3, 40)], shown)
    boxes = [text.get_window_extent() for text in shown.axes[0].texts]
    assert len(boxes) == 7
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    assert all(shown.axes[0].bbox.x0 <= box.x0 and box.x1 <= shown.axes[0].bbox.x1 for box in boxes)


@pytest.mark.parametrize(
    ("value", "words"), [(0.0, "0"), (3.14159, "3.14"), (1234.5, "1,230"), (2e-5, "2.0e-5"), (0.0015, "0.0015")]
)
def test_figures_have_three_digits(value, words):
    assert figure(value) == words


def test_times_have_units():
    assert [seconds(v) for v in (12.0, 1.5e-3, 2e-6)] == ["12 s", "1.5 ms", "2 µs"]


def test_a_page_asks_each_question_once_with_a_picture_and_draws_it(tmp_path):
    rows = [row(name, "curve", n, n, n) for name in NAMES for n in (1, 2)]
    made = page(rows)
    assert [section.question for section in made.sections] == [question.text for question in QUESTIONS]
    for section in made.sections:
        write_picture(section.pictures[0], tmp_path / "a.png")
        assert 5_000 < (tmp_path / "a.png").stat().st_size < 200_000
    assert [table.name for table in made.tables()] == ["work_precision"] and len(made.tables()[0].rows) == len(rows)


def test_every_conclusion_of_the_documents_follows_from_their_figures():
    entry = published.read_figures()["work-precision"]
    columns, rows = (entry["tables"]["work_precision"][name] for name in ("columns", "rows"))
    made = page([Row(**dict(zip(columns, values, strict=True))) for values in rows])
    assert [section.answer for section in made.sections] == entry["answers"]


def test_why_the_horizon_stays_is_so_in_the_figures():
    """No shorter one waits as little, and QoE does not fall by what they wait more."""
    table = published.read_figures()["work-precision"]["tables"]["work_precision"]
    rows = [dict(zip(table["columns"], values, strict=True)) for values in table["rows"]]
    rows = [row for row in rows if row["question"] == "horizon"]
    for scene in {row["scene"] for row in rows}:
        waits = {row["setting"]: float(row["note"].split()[0]) for row in rows if row["scene"] == scene}
        assert min(waits, key=waits.get) == BY_NAME["horizon"].default[1] and len(waits) > 3
        qoe = {row["setting"]: row["error"] for row in rows if row["scene"] == scene}
        assert qoe["1"] > qoe[BY_NAME["horizon"].default[1]] - BY_NAME["horizon"].enough


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
    settings = dataclasses.replace(encode.ONE_RUNG, measure_pictures=0, decide_pictures=2, preset="ultrafast")
    monkeypatch.setattr(Bench, "ladder", lambda bench, scene: bench.package(scene, settings, "small"))
    options = Options(f"fox={two_frames}", only=("decode",), quick=True)
    made = run(options, Lab.at(tmp_path, quiet=True))
    assert "What does a cheaper rung save in decoding? Take " in text_of(made)
    assert run(options, Lab.at(tmp_path, quiet=True)).data == made.data  # times and all


def test_pictures_of_a_trial_are_drawn_as_its_curve_says(two_frames, tmp_path):
    settings = dataclasses.replace(encode.ONE_RUNG, measure_pictures=0, decide_pictures=2, preset="ultrafast")
    scene = open_scene(f"fox={two_frames}")
    subject = survey.Subject(scene, Bench((scene,), tmp_path).package(scene, settings, "small"), 1)
    cameras = {curve: next(survey.draws(subject, curve, 4, 1)) for curve in (survey.APART, survey.ONE_VIEW)}
    assert len({camera.name for _, camera in cameras[survey.APART]}) == 4
    assert len({camera.name for _, camera in cameras[survey.ONE_VIEW]}) == 1
    assert len({n for n, _ in next(survey.draws(subject, survey.ONE_FRAME, 4, 1))}) == 1


def test_sessions_give_qoe_and_waiting_over_links_of_a_share_of_the_top_rung():
    offers = Offers.of(open_package(VALID / "moving"))
    made = selector.Links(offers, (), 2)
    place = Place("policies", "moving", "policies", "throughput")
    (found,) = selector.sessions(made, place, 1.5, partial(make_policy, "throughput", offers))
    assert found.unit == "dB of QoE" and found.runs > 2 and found.note.endswith("% waiting")
    (scarce,) = selector.sessions(made, place, 0.2, partial(make_policy, "throughput", offers))
    assert scarce.error < found.error and float(scarce.note.split()[0]) > float(found.note.split()[0])
    trace = markov_trace(1)
    (link,) = selector.Links(offers, (trace,), 2).over(0.5)
    m = offers.manifest
    assert link.trace.mean_bps == pytest.approx(0.5 * 8 * m.bytes_of(m.rung_files(0, 0)) / offers.duration_s)


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


def test_every_question_has_a_name_of_its_own():
    assert len(set(NAMES)) == len(QUESTIONS) and work_precision.QUESTIONS is QUESTIONS
