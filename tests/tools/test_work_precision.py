"""The report on error against run time: conclusions follow from rows, and a run that was killed goes on."""

import dataclasses
import json
import math

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.play.policies.named import ORACLES
from tools import work_precision
from tools.precision import conclusions, decode, encode, renderer, selector, survey, trainer
from tools.precision.bench import FOX, Bench, open_scene
from tools.precision.page import Made, conclude, page
from tools.precision.panels import NAMES, SECTIONS
from tools.precision.pictures import plot
from tools.precision.rows import Kept, Place, Row, Took, plain, quartiles
from tools.precision.words import changed, figure, seconds, times


def row(panel, curve, setting, took, error, size=math.nan, scene="fox"):
    section = next(s.name for s in SECTIONS for p in s.panels if p.name == panel)
    return Row.of(Place(section, panel, scene, curve, str(setting)), [Took(took, 2 * took)], [error], "dB", size)


def rows_of_everything():
    """Made-up rows for every panel."""
    rows = [
        row("presets", encode.PLAIN, "ultrafast", 2.0, 20.0, 20e3),
        row("presets", encode.PLAIN, "slow", 6.2, 1, 17600),
    ]
    rows += [
        row("presets", encode.CALIBRATED, "slow", 8.2, 1, 16e3),
        row("presets", encode.PREVIEW, "--quick", 0.82, 1, 20e3),
    ]
    for curve, error in ((survey.APART, 0.1), (survey.ONE_VIEW, 0.8), (survey.ONE_FRAME, 0.3)):
        rows += [row("claims", curve, count, 0.1 * count, error / count) for count in (1, 4)]
    rows += [row("deciding", "calibrated", 2, 0.2, 1, 10e3), row("deciding", "calibrated", 48, 2.0, 1, 9e3)]
    rows += [row("rungs", decode.RUNGS, "L0", 4e-3, 43.0), row("rungs", decode.RUNGS, "L4", 2e-3, 31.0)]
    rows += [row("rungs", decode.TIERS, "1 of 3", 4e-3, 40.0), row("rungs", decode.KEYS, "Q0", 1e-3, 25.0)]
    rows += [row("stages", decode.H264, "L0", 3e-3, math.nan), row("stages", decode.STATES, "L0", 1e-3, math.nan)]
    names = (renderer.SHIPPED, f"{renderer.DEFINITION}, float32", f"{renderer.DEFINITION}, float64")
    rows += [
        row("precision", n, "320 x 320", s, e) for n, s, e in zip(names, (0.01, 4, 8), (0.002, 0.001, 0), strict=True)
    ]
    rows += [row("tiles", "fox", 8, 0.02, 0.002), row("tiles", "fox", renderer.TILE, 0.01, 0.002)]
    rows += [row("cuts", "fox", "1/32", 0.005, 0.5), row("cuts", "fox", "1/255", 0.01, 0.002)]
    rows += [row("first", "first frame", n, n / 100, 30 + n / 1000) for n in (800, 1600)]
    rows += [row("views", "1 an iteration", 800, 8, 31.0), row("views", "4 an iteration", 200, 7, 30.5)]
    rows += [row("keyframe", trainer.WARM_CURVE, n, n / 100, 30 + n / 100) for n in (25, 100)]
    rows += [row("keyframe", trainer.SCRATCH_CURVE, 1600, 16, 30.5)]
    rows += [
        row("frame", "direct", 30, 0.3, 31.0),
        row("frame", "direct", 300, 3, 32.0),
        row("frame", "mlp", 300, 9, 31.5),
    ]
    rows += [
        row("policies", n, n, s, e) for n, s, e in (("a", 1e-5, 0.5), ("b", 1e-3, 0.2), (next(iter(ORACLES)), 0.1, 0.1))
    ]
    for curve in (selector.MPC, selector.LP, selector.MILP):
        rows += [row("horizon", curve, 1, 1e-4, 0.6), row("horizon", curve, 8, 1e-3, 0.3)]
    for curve, took in ((selector.DENSE_GREEDY, 1e-5), (selector.DENSE_MILP, 1e-3)):
        rows += [row("levels", curve, 4, took, 0.12), row("levels", curve, 64, took, 0.01)]
    return rows


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.name)
def test_every_panel_has_one_sentence_of_conclusion_and_none_without_rows(section):
    rows = rows_of_everything()
    for panel in section.panels:
        sentence = conclude(section, panel, rows)
        assert sentence[0] == sentence[0].upper() and sentence.endswith(".") and ". " not in sentence, panel.name
        assert "nan" not in sentence
        assert conclude(section, panel, []) == ""
        one = section.rows_of(panel, rows)[:1]
        assert isinstance(conclude(section, panel, one), str)  # a run may have made only the first


@pytest.mark.parametrize(
    ("section", "panel", "sentence"),
    [
        (
            "encode",
            "presets",
            "On fox, `slow` saves 12 % of the bytes of `ultrafast` at 43 dB and takes 3.1 times as long, calibration "
            "saves 9 % of the bytes at `slow` and adds 2 s, beside that `--quick` needs 25 % more bytes and takes 10 % "
            "of the time.",
        ),
        (
            "decode",
            "rungs",
            "On fox, the top rung decodes in 4 ms a frame: level L4 takes 50 % of the time and is 12 dB below, the "
            "first key tier alone (1 of 3) takes as long and is 3 dB below, a key without states takes 25 % of the "
            "time and is 18 dB below.",
        ),
        ("decode", "stages", "On fox, decoding H.264 of states takes 75 % of 4 ms a frame."),
        (
            "trainer",
            "keyframe",
            "From the frame before a keyframe has 31.0 dB after 1 s, from scratch 30.5 dB after 16 s.",
        ),
        (
            "selector",
            "levels",
            "64 levels in place of 4 lower the regret from 0.12 to 0.010 dB; the integer programme has the same, for "
            "1 ms a frame in place of 10 µs.",
        ),
    ],
)
def test_conclusions_are_computed_from_the_rows(section, panel, sentence):
    part = next(s for s in SECTIONS if s.name == section)
    which = next(p for p in part.panels if p.name == panel)
    assert conclude(part, which, rows_of_everything()) == sentence


def test_a_conclusion_changes_when_rows_do():
    rows = [dataclasses.replace(r, bytes=40e3) if r.setting == "slow" else r for r in rows_of_everything()]
    assert "`slow` needs 100 % more bytes" in conclusions.presets([r for r in rows if r.panel == "presets"])


def test_a_way_that_is_not_measured_yet_is_left_out():
    rows = [r for r in rows_of_everything() if r.panel == "horizon" and r.curve != selector.MILP]
    sentence = conclusions.horizon(rows)
    assert f"`{selector.LP}` goes from 0.60 to 0.30 dB" in sentence and selector.MILP not in sentence
    assert "8 segments ahead in place of 1" in sentence


def test_a_ladder_that_does_worse_is_not_said_to_lower_the_regret():
    rows = [r for r in rows_of_everything() if r.panel == "levels"]
    assert " lower the regret" in conclusions.levels(rows)
    worse = [dataclasses.replace(r, error=0.2) if r.setting == "64" else r for r in rows]
    assert " raise the regret" in conclusions.levels(worse)


def test_scenes_are_told_apart():
    rows = [row("stages", decode.H264, "L0", 1e-3, math.nan, scene=s) for s in ("fox", "spinach")]
    assert conclusions.stages(rows).count("takes 100 %") == 2


def test_words_of_figures():
    assert [seconds(s) for s in (12.3, 0.0123, 4.5e-6)] == ["12 s", "12 ms", "4.5 µs"]
    assert [figure(v) for v in (0.0, 0.0456, 1234.5, 1.2e-5)] == ["0", "0.046", "1,230", "1.2e-5"]
    assert times(1.0, 1.0) == "takes as long" and times(0.3, 1.0) == "takes 30 % of the time"
    assert changed(100.1, 100.0, "bytes") == "takes as many bytes"
    assert quartiles([3.0, 1.0, 2.0]) == (2.0, 1.5, 2.5)


def test_a_killed_run_does_only_what_is_missing(tmp_path):
    path, done = tmp_path / "rows.jsonl", []

    def measured(kept, names):
        def work(name):
            done.append(name)
            return [row("first", "c", name, 1.0, math.nan)]

        return [r for name in names for r in kept.once({"name": name}, lambda: work(name))]  # noqa: B023

    first = measured(Kept(path), "ab")
    path.write_text(path.read_text() + '{"settings": {"name": "c"}, "ro')  # killed while it wrote
    again = measured(Kept(path), "abc")
    assert done == ["a", "b", "c"]
    assert [r.setting for r in measured(Kept(path, more=False), "bd")] == ["b"] and done == ["a", "b", "c"]
    assert [plain(r) for r in again[:2]] == [plain(r) for r in first]
    assert [json.loads(line)["settings"]["name"] for line in path.read_text().splitlines()] == ["a", "b", "c"]


def test_rows_of_other_settings_are_measured_anew(tmp_path):
    kept, scene = Kept(tmp_path / "rows.jsonl"), open_scene(f"fox={FOX}")
    other = dataclasses.replace(scene, name="other")
    told = []
    for which in (scene, other, scene):
        Bench((which,), tmp_path, kept).once(which, {"a": 1}, lambda: told.append(1) or [])
    assert len(told) == 2


def test_the_page_has_every_question_and_picture_that_has_rows(tmp_path):
    rows = rows_of_everything()
    text = page(rows, Made("python -m tools.work_precision -o out/", "Measured here.", ["fox"]))
    text = " ".join(text.split())
    assert all(f"**{p.question}** {conclude(s, p, rows)}" in text for s in SECTIONS for p in s.panels)
    assert all(f"(precision-{name}.png)" in text for name in NAMES)
    some = [r for r in rows if r.section == "encode"]
    assert "precision-decode.png" not in page(some, Made("", "", []))
    for section in SECTIONS[1:3]:  # curves on logarithmic axes, and bars
        plot(section, rows, tmp_path / f"{section.name}.png")
        assert 5_000 < (tmp_path / f"{section.name}.png").stat().st_size < 150_000


def test_kernels_with_other_constants_are_made_of_the_renderers_source(tmp_path):
    assert renderer.variant(tmp_path, "tiles", 8).TILE == 8
    coarse = renderer.variant(tmp_path, "cuts", 64)
    darkest, brightest = (
        sum(float(e) * x**i for i, e in enumerate(_coefficients(coarse))) ** 8 for x in (0, math.log(64))
    )
    assert darkest == pytest.approx(1 / 64, rel=1e-4) and brightest == pytest.approx(1, rel=1e-4)
    with pytest.raises(ConfigError, match="expected 'NOT THERE'"):
        renderer.replaced("source", {"NOT THERE": ""})


def _coefficients(kernels):
    return [getattr(kernels, f"E{i}") for i in range(6)]


def test_a_quick_section_runs_end_to_end(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(decode, "FRAMES", 1)
    settings = dataclasses.replace(encode.ONE_RUNG, measure_pictures=0, decide_pictures=2, preset="ultrafast")
    monkeypatch.setattr(Bench, "ladder", lambda bench, scene: bench.package(scene, settings, "small"))
    scene = tmp_path / "two"
    scene.mkdir()
    for name in ("000000.ply", "000001.ply", "transforms.json"):
        (scene / name).symlink_to(FOX / name)
    words = ["-o", str(tmp_path), "--quick", "--only", "decode", "--scene", f"fox={scene}"]
    assert work_precision.main(words) == 0
    first = capsys.readouterr().out
    assert "decode/stages fox" in first and "Where does the time of the top rung go? On fox" in first
    assert work_precision.main(words) == 0
    assert "decode/stages fox" not in capsys.readouterr().out  # it was kept
    record = json.loads((tmp_path / "work_precision.json").read_text())
    assert (
        record["machine"]["cores"]
        and len(record["rows"]) == len((tmp_path / "rows.jsonl").read_text().splitlines()) + 3
    )
    assert (tmp_path / "precision-decode.png").is_file() and (tmp_path / "work_precision.csv").is_file()
    assert "## Decoding" in (tmp_path / "work_precision.md").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scene", "fox"], "expected NAME=FOLDER"),
        (["--scene", "fox=/nowhere"], "nowhere"),
        (["--finished", "--only", "encode"], "expected finished measurements"),
    ],
)
def test_scenes_that_are_not_there_are_one_line(tmp_path, words, message, capsys):
    assert work_precision.main(["-o", str(tmp_path), *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_sections_that_do_not_exist_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        work_precision.main(["-o", str(tmp_path), "--only", "encode,nothing"])
    assert "got nothing" in capsys.readouterr().err
