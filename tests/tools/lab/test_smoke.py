"""Every experiment runs in its smallest form, and gives the tables and columns that are published of it.

Nothing is encoded or trained for it: packages are copies of committed ones, and models are clouds that nobody fitted.
"""

import json
import shlex
import shutil
from contextlib import nullcontext
from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import pytest

from tests.faces import AirgsError, FrameRecord, TrainedFrame, airgs_encode, airgs_train, open_package
from tests.support.paths import FOX, FOX_VIEWS, GOLDEN, VALID
from tests.support.scenes import write_demo
from tests.support.training import write_blobs
from tests.support.views import coloured_cloud, ring, views_of
from tools import check_gpu, make_footage
from tools.lab import Took, main, seconds_of
from tools.lab.experiments import EXPERIMENTS
from tools.lab.numerics import extremes, rows, sequences, stiff, work_precision
from tools.lab.paper import server, training
from tools.lab.published import read_figures
from tools.lab.rd.coders import layout_trials
from tools.lab.rd.written import written_trials
from tools.lab.timing import Alone

RUNS = {  # by the names of what is published: commands, in a folder with the scenes of `scenes`
    "scenes": "scenes fox=fox/transforms.json",
    "rd-fox": "rd fox fox/transforms.json --frames 2 --at 30",
    "claims": "claims fox --targets 99.9 default --pictures 2",
    "rivals": "rivals fox=fox/transforms.json --qps 6 --frames 2",
    "mechanisms": "mechanisms fox@fox/transforms.json views/fox:0:3 --only 'colour transform' "
    "'keyframes as differences' 'empty space stays empty' 'motion goes on'",
    "static": "static fox/000000.ply",
    "tracked-head": "tracked head head/transforms.json --frames 2",
    "paper": "reproduce --scenes fox=views/fox,frames=0:4 --methods airgs-paper naive3dgs --traces traces --share .01",
    "splits-fox": "splits views/fox --splits 1 --hold 2 --frames 0:2",
    "work-precision": "work-precision --fox fox --only decode --quick",
    "stiff": "stiff --quick",
    "extremes": "extremes",
    "streaming": "streaming fox --links links=traces --starts 1 --seconds 1 --policies throughput bola",
    "viewpoints": "viewpoints fox=fox/transforms.json",
    "upright": "upright fox/000000.ply@y@z --held 000000",
    "scale": "scale --rows 200 --frames 2 --few 100",
    "jobs": "jobs --frames 4 --rows 100",
    "link": "link package const:5 --seconds 0.2",
    "pace": "pace fox --presets fast --repeats 1",
    "pace-train": "pace views/fox --train --frames 2",
    "soak-farm": "soak-farm --groups 1 --kills 4",
}
UNPUBLISHED = {"pace-train"}
ALONE = {
    check_gpu: "views/fox --sequence fox --device cpu --cameras 1",
    make_footage: "fox --frames 0:1 --max-size 24 --points 50",
}
TWINS = {"rd-spinach", "rd-talk", "tracked-fox", "splits-basketball", "splits-kinoptic"}
TWINS |= {f"mechanisms-{name}" for name in ("basketball", "trainer", "sparse", "exposure")}


def encode(sequence, folder, settings=None, goal=None, **_):
    if goal is not None and goal.value > 99:
        raise AirgsError("out of reach")
    by_quality = {0.8: GOLDEN / "room", 1.0: GOLDEN / "fox", 1.25: VALID / "moving"}
    package = by_quality[settings.quality if settings else 1.0]
    shutil.copytree(package, folder)
    plan = SimpleNamespace(choices=[])
    return SimpleNamespace(manifest=open_package(package).manifest, plan=plan, encode_s=1.0, measure_s=1.0)


def train_chunk(capture, frames, *rest):
    shown = {"psnr": 30.0, "held_out_psnr": 29.0, "held_out_matched": 29.5, "held_out_ssim": 0.9, "rejected_psnr": None}
    for t in frames:
        kind = "first" if t == 0 else "keyframe" if t % 3 == 0 else "frame"
        yield TrainedFrame(coloured_cloud(20), FrameRecord(t, kind, gaussians=20, added=0, seconds=1.0, **shown))


def alone(function, *arguments, limit_s=None):
    took, value = seconds_of(lambda: function(*arguments))
    return Alone(took, 1.0), value


def known_extremes(*_):
    """Its cases are tested where the encoder is: here they are as published."""
    table = read_figures()["extremes"]["tables"]["extremes"]
    known = {row[0]: dict(zip(table["columns"], row, strict=True)) for row in table["rows"]}
    return extremes.page([known[case.name] for case in sequences.CASES])


ENCODE = {"encode": encode}
TRAIN = {"train_first": lambda capture, *rest: next(train_chunk(capture, range(1)))}


def run_here(words, **_):
    return SimpleNamespace(returncode=(airgs_encode if "encode" in words[2] else airgs_train)(words[3:]))


COMMAND = SimpleNamespace(run=run_here, DEVNULL=None)
FARM = """
import os, shutil, sys
os.chdir(sys.argv[2])
os.makedirs("jobs", exist_ok=True)
open("jobs/one", "wb").write(bytes(9))
shutil.copytree("one.airgs", "farm.airgs")
"""
INSTEAD = {
    "airgs_codec.trainer.pipeline": {**TRAIN, "train_chunk": train_chunk},
    **{f"tools.lab.{name}": ENCODE for name in ("baselines.airgs", "bench.claims", "bench.jobs")},
    **{f"tools.{name}": {**ENCODE, "alone": alone} for name in ("check_gpu", "lab.bench.scale")},
    "tools.lab.bench.mechanisms": {**ENCODE, **TRAIN, "SPLITS": (1,), "FRAMES": 2},
    "tools.lab.bench.soak_farm": {**ENCODE, "PAUSE_S": 0.02, "ROWS": 9, "COMMAND": FARM},
    "tools.lab.bench.soak_farm.Cluster": {"keep": lambda _: None, "kill": lambda *_: None},
    **{f"tools.lab.bench.{name}": {"subprocess": COMMAND} for name in ("pace", "splits")},
    "tools.lab.bench.static": {**ENCODE, "DRAWS": 2},
    "tools.lab.bench.tracked": {**ENCODE, "tracked": lambda given, *_: nullcontext(given)},
    "tools.lab.numerics.extremes": {"run": known_extremes},
    "tools.lab.numerics.rows.Bench": {"ladder": lambda *_: open_package(GOLDEN / "fox")},
    "tools.lab.numerics.stiff": {
        "CASES": [replace(case, judge=lambda *_: ("bounded", 0.5, "")) for case in stiff.CASES]
    },
    "tools.lab.paper.reproduce": {"in_processes": lambda work, calls, *_: [work(*one) for one in calls]},
    "tools.lab.rd.experiment": {"trials": lambda _: (*islice(layout_trials(), 2), *islice(written_trials(), 1))},
}


def write_scenes(folder):
    for name in ("fox", "head"):
        write_demo(folder / name, frames=4, rows=700, scale=0.1)
    write_blobs(folder / "views" / "fox")
    (folder / "traces").mkdir()
    (folder / "traces" / "one.csv").symlink_to(FOX / "trace.csv")
    (folder / "package").symlink_to(GOLDEN / "fox")


@pytest.fixture
def scenes(made_once, monkeypatch, tmp_path):
    """The folder to be in has small scenes, and what takes long is replaced."""
    monkeypatch.chdir(made_once("lab", write_scenes))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # which some experiments set for themselves
    for owner, values in INSTEAD.items():
        for name, value in values.items():
            monkeypatch.setattr(f"{owner}.{name}", value)


@pytest.mark.usefixtures("scenes")
@pytest.mark.parametrize("name", RUNS)
def test_it_gives_the_tables_that_are_published(name, tmp_path):
    words = shlex.split(RUNS[name])
    assert main([*words, "-o", str(tmp_path / "lab")]) == 0
    assert all(path.stat().st_size > 2_000 for path in (tmp_path / "lab").glob("*.png"))
    tables = json.loads((tmp_path / "lab" / f"{words[0]}.json").read_text())["figures"]
    found = {table: {key for row in rows for key in row} for table, rows in tables.items() if rows}
    published = read_figures()[name]["tables"] if name not in UNPUBLISHED else {}
    for table, one in published.items():
        assert {*one["columns"]} - {"note"} == found[table] - {"note"}, table
    if published and name not in ("rd-fox", "claims"):  # whose pages show some rows of other tables
        assert list(found) == list(published)


@pytest.mark.usefixtures("scenes")
@pytest.mark.parametrize("module", ALONE, ids=lambda module: module.TOOL.name)
def test_tools_that_are_no_experiments_write_a_page_as_these_do(module, tmp_path):
    assert module.main([*shlex.split(ALONE[module]), "-o", str(tmp_path)]) == 0
    assert f'"python -m {module.__name__} ' in (tmp_path / f"{module.TOOL.name}.json").read_text()


def test_every_published_experiment_is_run_here():
    """But for what needs a browser, and for twins."""
    assert {*RUNS, *TWINS, "engines"} - UNPUBLISHED == set(read_figures())
    assert {words.split()[0] for words in RUNS.values()} | {"engines"} == {one.name for one in EXPERIMENTS}


def test_no_ablation_of_the_paper_has_the_settings_of_another():
    subject, means = training.parse_subject(f"fox={FOX_VIEWS}"), training.Means(4_500, 0.1)
    methods = {name: training.ours(name, subject, means) for name in training.ABLATIONS}
    assert len({json.dumps(one.settings) for one in methods.values()}) == len(methods) > 7
    assert [methods[name].training.min_psnr_db for name in ("airgs", "airgs, tau alone", training.PAPER)] == [0, 30, 30]
    assert {one.training.capacity for one in methods.values()} == {4_500}


def test_the_papers_server_sends_what_its_viewer_lacks(package_of):
    pictures = SimpleNamespace(train=(seen := lambda t: views_of(coloured_cloud(), ring(2))), held_out=seen)
    serve = server.Server(open_package(package_of("paper")), pictures)
    sizes, late = ([option.size_bytes for option in serve.levels(past)] for past in ([0, 0], [0, -1]))
    assert sizes == sorted(sizes, reverse=True) and sizes[-1] < sizes[0] < late[0]
    assert serve.psnr([0, -1, 0], 2, 2) == serve.psnr([0, 0, 0], 2, 2)  # what was skipped comes with the next


@pytest.mark.parametrize(("bola", "sign"), [
    ([3, 4, 3, 4, 3, 5], 1), ([3, 4, 3, 4, 3, -9], 0), ([1, 2, 1, 1, 1, 2], -1), ([9, 9], 0),  # two pairs are chance
])  # fmt: skip
def test_a_difference_is_beyond_its_error_or_none(bola, sign):
    question, made = next(one for one in work_precision.QUESTIONS if one.name == "policies"), []
    for name, took, values in (("robust-mpc", 2.0, [2, 3, 2, 3, 2, 3][: len(bola)]), ("bola", 1.0, bola)):
        place = rows.Place("policies", "fox", "policies", name)
        made.append(rows.Row.by(place, [Took(took, took)], rows.average(values), "dB of QoE", samples=values))
    found = list(work_precision.beside(question, made))[-1]
    assert (found["setting"], found["time"], found["sign"]) == ("bola", 0.5, sign)
