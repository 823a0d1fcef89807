"""Every experiment runs in its smallest form, and gives the tables and columns that are published of it."""

from dataclasses import replace
from functools import partial
from itertools import islice

import pytest

from tests.faces import ConfigError, EncodeSettings, LevelSettings, encode, open_scene, write_ply
from tests.support.paths import FOX, GOLDEN
from tests.support.scenes import moving_frames, random_gaussians, write_sequence
from tests.support.temporal import write_temporal
from tests.support.training import SETTINGS, write_blobs
from tools.lab import Lab
from tools.lab.baselines import rivals
from tools.lab.bench import (
    claims,
    jobs,
    link,
    mechanisms,
    scale,
    scenes,
    soak_farm,
    splits,
    static,
    streaming,
    tracked,
    viewpoints,
)
from tools.lab.experiments import EXPERIMENTS, NO_LONGER_MEASURED
from tools.lab.numerics import extremes, sequences, stiff, work_precision
from tools.lab.numerics.rows import Bench
from tools.lab.page import text_of, write_picture
from tools.lab.paper import footage, reproduce, training
from tools.lab.published import read_figures
from tools.lab.rd import experiment as rd
from tools.lab.rd.coders import layout_trials
from tools.lab.rd.written import written_trials

QUICK = EncodeSettings(calibrate="none", measure_pictures=2, preset="ultrafast", threads=1)
ONE_RUNG = replace(QUICK, measure_pictures=0, levels=(LevelSettings(0.0),))
FOX_WITH_VIEWS = f"{FOX}={FOX / 'transforms.json'}"


def run_scenes(tmp, patch):
    return scenes.run(scenes.Options((FOX_WITH_VIEWS,)), Lab.at(tmp, quiet=True))


def run_rd(tmp, patch):
    patch.setattr(rd, "trials", lambda options: (*islice(layout_trials(), 2), *islice(written_trials(), 1)))
    scene = write_sequence(tmp / "fox", moving_frames(200, 3))
    options = rd.Options(scene, views=scene / "transforms.json", frames=2, at=30.0)
    return rd.run(options, Lab.at(tmp / "lab", quiet=True))


def run_claims(tmp, patch):
    patch.setattr(claims, "encode", partial(encode, settings=replace(QUICK, margin=0.1)))
    clip = write_temporal(tmp / "clip", count=120, frames=3, size=24)
    options = claims.Options((str(clip),), targets=("99.9", "default"), pictures=2)
    page = claims.run(options, Lab.at(tmp / "lab"))
    assert "Of 1 top rungs" in page.sections[0].answer  # 99.9 dB is out of reach, and it goes on
    return page


def run_rivals(tmp, patch):
    page = rivals.run(rivals.Options((FOX_WITH_VIEWS,), qps=(6,), frames=2), Lab.at(tmp, quiet=True))
    (row,) = page.tables()[1].rows
    assert abs(row["stored_db"] - row["activated_db"]) > 0.1  # they are not the same one
    return page


def run_mechanisms(tmp, patch):
    patch.setattr(mechanisms, "PLAIN", replace(QUICK, calibrate="ladder"))
    scene = write_sequence(tmp / "scene", moving_frames(300, 3, 1))
    only = ("colour transform", "keyframes as differences", "empty space stays empty", "motion goes on")
    options = mechanisms.Options((f"{scene}@{scene / 'transforms.json'}", f"{write_blobs(tmp / 'blobs')}:0:3"), only)
    small = replace(SETTINGS, first_iterations=30, key_iterations=10, frame_iterations=5)
    patch.setattr(mechanisms, "TrainSettings", lambda **_: small)
    patch.setattr(mechanisms, "SPLITS", (1,))
    page = mechanisms.run(options, Lab.at(tmp / "lab", quiet=True))
    assert [row["scene"] for row in page.tables()[0].rows[2:]] == ["blobs:0:3/1"] * 2
    return page


def run_static(tmp, patch):
    patch.setattr(static, "encode", lambda scene, folder, *_, **__: encode(scene, folder, QUICK))
    write_ply(tmp / "still.ply", random_gaussians(200))
    patch.setattr(static, "DRAWS", 2)
    return static.run(static.Options((tmp / "still.ply",)), Lab.at(tmp / "lab", quiet=True))


def run_tracked(tmp, patch):
    patch.setattr(tracked, "encode", lambda scene, folder, *_: encode(scene, folder, QUICK))
    scene = write_sequence(tmp / "head120", moving_frames(100, 2))
    options = tracked.Options(scene, views=scene / "transforms.json", frames=2)
    return tracked.run(options, Lab.at(tmp / "lab", quiet=True))


def run_paper(tmp, patch):
    patch.setattr(reproduce, "in_processes", lambda work, calls, *_: [work(*one) for one in calls])
    small = replace(SETTINGS, first_iterations=30, key_iterations=10, frame_iterations=5)
    patch.setattr(training, "trainer_settings", lambda *_: small)
    patch.setattr(training, "QUICK_FIRST", 30)
    scene = f"fox={write_blobs(tmp / 'blobs')}"
    options = reproduce.Options((f"{scene},frames=0:2",), ("airgs", "naive3dgs"), show=("fox",), quick=True)
    return reproduce.run(options, Lab.at(tmp / "lab", quiet=True))


def run_splits(tmp, patch):
    scene = write_blobs(tmp / "fox")
    options = splits.Options(scene, splits=1, hold=2, frames="0:2", train="--iterations 30,10,5")
    return splits.run(options, Lab.at(tmp / "lab", quiet=True))


def run_work_precision(tmp, patch):
    patch.setattr(Bench, "ladder", lambda bench, scene: bench.package(scene, ONE_RUNG, "small"))
    two = tmp / "two"
    two.mkdir()
    for name in ("000000.ply", "000001.ply", "transforms.json"):
        (two / name).symlink_to(FOX / name)
    options = work_precision.Options(two, only=("decode",), quick=True)
    page = work_precision.run(options, Lab.at(tmp / "lab", quiet=True))
    assert work_precision.run(options, Lab.at(tmp / "lab", quiet=True)).data == page.data  # it is not measured twice
    return page


def run_stiff(tmp, patch):
    some = [case for case in stiff.CASES if case.name in ("codec-closed-form", "selector-programmes")]
    patch.setattr(stiff, "CASES", some)
    return stiff.run(stiff.Options(quick=True), Lab.at(tmp, quiet=True))


def run_extremes(tmp, patch):
    """Its cases are tested where the encoder is: here they are as published."""
    table = read_figures()["extremes"]["tables"]["extremes"]
    known = {row[0]: dict(zip(table["columns"], row, strict=True)) for row in table["rows"]}
    return extremes.page([known[case.name] for case in sequences.CASES])


def run_streaming(tmp, patch):
    (tmp / "traces").mkdir()
    (tmp / "traces" / "one.csv").symlink_to(FOX / "trace.csv")
    policies = ("throughput", streaming.CLIFF, streaming.NO_CLIFF)
    options = streaming.Options(tmp / "traces", (str(GOLDEN / "fox"),), policies, starts=2, seconds=2, jobs=1)
    return streaming.run(options, Lab.at(tmp / "lab", quiet=True))


def run_viewpoints(tmp, patch):
    return viewpoints.run(viewpoints.Options((FOX_WITH_VIEWS,)), Lab.at(tmp, quiet=True))


def run_scale(tmp, patch):
    return scale.run(scale.Options(rows=(), frames=(2,), few=200), Lab.at(tmp, quiet=True))


def run_jobs(tmp, patch):
    return jobs.run(jobs.Options(frames=4, rows=100), Lab.at(tmp, quiet=True))


RUNS = {
    "scenes": run_scenes, "rd-fox": run_rd, "claims": run_claims, "rivals": run_rivals, "mechanisms": run_mechanisms,
    "static": run_static, "tracked-head": run_tracked, "paper": run_paper,
    "splits-fox": run_splits, "work-precision": run_work_precision, "stiff": run_stiff,
    "extremes": run_extremes, "streaming": run_streaming, "viewpoints": run_viewpoints, "scale": run_scale,
    "jobs": run_jobs,
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_it_gives_the_tables_that_are_published(name, tmp_path, monkeypatch):
    page = RUNS[name](tmp_path, monkeypatch)
    published = {table: set(one["columns"]) for table, one in read_figures()[name]["tables"].items()}
    found = {table.name: {key for row in table.rows for key in row} for table in page.tables() if table.rows}
    if name not in ("rd-fox", "claims"):  # whose pages show some rows of other tables
        assert list(found) == list(published)
    for table, columns in published.items():
        assert columns - {"note"} == found[table] - {"note"}, table
    for picture in (picture for section in page.sections for picture in section.pictures):
        write_picture(picture, tmp_path / f"{picture.name}.png")
        assert (tmp_path / f"{picture.name}.png").stat().st_size > 2_000
    assert text_of(page) and not page.failed


def test_every_published_experiment_is_run_here():
    """But for what needs a browser, and for twins."""
    twins = {"rd-spinach", "rd-head", "tracked-fox", "paper-system", "splits-basketball", "splits-kinoptic"}
    twins |= {f"mechanisms-{name}" for name in ("basketball", "trainer", "motion", "exposure")}
    assert {*RUNS, *twins, "engines", *NO_LONGER_MEASURED} == set(read_figures())
    assert {one.name for one in EXPERIMENTS} > {"devices", "soak-farm", "link", "footage"}


def test_a_real_session_is_compared_with_a_simulated_one(tmp_path):
    page = link.run(link.Options(GOLDEN / "fox", ("const:5",), seconds=0.2), Lab.at(tmp_path))
    (row,) = page.sections[0].tables[0].rows
    assert 0 < row["same batches"] <= row["of"] and row["PSNR, dB"] > 30 and row["worst"] >= row["arrivals off, mean"]


def test_pictures_of_a_sequence_are_a_scene_to_train_on(tmp_path):
    page = footage.run(footage.Options(FOX, frames="0:1", max_size=24, points=50), Lab.at(tmp_path, quiet=True))
    scene = open_scene(tmp_path / "footage")
    assert len(scene) == 1 and "1 frames" in page.sections[0].answer
    assert max(scene.cameras[0].width, scene.cameras[0].height) == 24
    assert scene.points is not None and len(scene.points.positions) == 50


def test_two_workers_four_jobs_and_a_few_failures_end_with_the_same_bytes(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="Dask, the extra `farm`, is not installed")
    monkeypatch.setattr(soak_farm, "PAUSE_S", 0.5)
    monkeypatch.setattr(soak_farm, "ROWS", 200)
    page = soak_farm.run(soak_farm.Options(groups=1, kills=2, seed=1), Lab.at(tmp_path / "out"))
    (row,) = page.sections[0].tables[0].rows
    assert row["same bytes"] and not page.failed and row["jobs"] >= 4 and row["made"] >= 2
    assert "Traceback" not in (tmp_path / "out" / "runs.log").read_text()
    with pytest.raises(ConfigError, match="expected a new folder"):
        soak_farm.run(soak_farm.Options(), Lab.at(tmp_path / "out"))
