"""The public names: each resolves, is documented, is typed and costs nothing until it is used; what they are given.

A path opens what is at it; what is of no use is refused in one line; `progress=` takes a function or a class of bars.
"""

import ast
import inspect
import pickle
import subprocess
import sys
from dataclasses import MISSING, fields, replace
from functools import partial
from typing import ClassVar

import numpy as np
import pytest
from tqdm.auto import tqdm

import airgs_codec as airgs
from airgs_codec.progress import as_reporter
from tests.faces import summarise, write_ply
from tests.support.paths import FOX, GOLDEN
from tests.support.paths import PACKAGE as CODE
from tests.support.scenes import moving_frames, write_sequence

PACKAGE = GOLDEN / "fox"  # of the embedded sequence
SEQUENCE = airgs.open_sequence(FOX)
SIMULATE = partial(airgs.simulate, PACKAGE, "const:5")
FAST = airgs.EncodeSettings(calibrate="none", measure_pictures=0, preset="ultrafast")
NAMES = {
    "AirgsError", "Camera", "Decision", "EncodeSettings", "Gaussians", "Goal", "Package", "Plan", "PlayerState",
    "Sequence", "SessionSettings", "Trace", "TrainSettings", "compare", "decide", "decode", "decode_frames", "draw",
    "encode", "input_rows", "open_package", "open_sequence", "read", "simulate", "train", "validate", "write",
}  # fmt: skip
FUNCTIONS = sorted(name for name in NAMES if name[0].islower())
OPENING = {"open_package", "open_sequence", "read", "validate"}


def test_the_names_are_these_and_no_others():
    assert sorted(NAMES) == airgs.__all__ and len(NAMES) <= 27
    assert set(dir(airgs)) >= NAMES
    with pytest.raises(AttributeError, match="no_such_name"):
        airgs.no_such_name  # noqa: B018
    with pytest.raises(ImportError):
        exec("from airgs_codec import no_such_name")


@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_name_resolves_to_what_is_defined_under_it_and_is_documented(name):
    value = getattr(airgs, name)
    assert value.__name__ == ("GaussianSequence" if name == "Sequence" else name)
    assert value.__module__.startswith("airgs_codec.")
    words = inspect.getdoc(value)
    assert words and words[0].isupper()
    assert "\n" in words or name not in FUNCTIONS, "a function says more than one line"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_typed_take_text_for_a_path_and_say_what_they_raise(name):
    signature = inspect.signature(getattr(airgs, name))
    assert signature.return_annotation is not signature.empty
    annotations = [parameter.annotation for parameter in signature.parameters.values()]
    assert signature.empty not in annotations
    assert (annotations[0] == "str | Path") == (name in OPENING)
    assert "aises" in inspect.getdoc(getattr(airgs, name))


def test_type_checkers_see_the_same_names_in_the_same_places():
    tree = ast.parse((CODE / "__init__.py").read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    *imports, last = block.body
    seen = {alias.name: node.module for node in imports for alias in node.names}
    assert ast.unparse(last) == "Sequence = GaussianSequence"
    assert seen == {getattr(airgs, name).__name__: getattr(airgs, name).__module__ for name in NAMES}
    assert (CODE / "py.typed").is_file()


def python(folder, *words):
    """What another process says to stderr, which must end well."""
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr


LIGHT = """
import sys, airgs_codec
heavy = {"numpy", "numba", "scipy", "torch", "cv2", "av", "colour", "matplotlib", "tqdm"}
assert not heavy & sys.modules.keys(), sys.modules
from airgs_codec.cli.train import main
assert main(["."]) == 2 and "torch" not in sys.modules, "a folder without pictures is refused before it is loaded"
"""


def test_nothing_heavy_is_loaded_before_it_is_used(tmp_path):
    assert "expected multi-view pictures" in python(tmp_path, "-c", LIGHT)


OTHERS = """
import sys
from multiprocessing import get_context
import airgs_codec as airgs

def drawn(package):
    return airgs.draw(airgs.decode(package, 0), package.cameras[0]).rgb.tobytes()

if __name__ == "__main__":
    package = airgs.open_package(sys.argv[1])
    here = drawn(package)
    for method in ("fork", "spawn", "forkserver"):
        with get_context(method).Pool(1) as pool:
            assert pool.apply(drawn, (package,)) == here, method
"""


def test_other_processes_draw_however_they_are_started_after_this_one_has_drawn(tmp_path):
    (tmp_path / "others.py").write_text(OTHERS)
    python(tmp_path, "others.py", PACKAGE)


@pytest.fixture(scope="module")
def public():
    package, sequence = airgs.open_package(PACKAGE), airgs.open_sequence(FOX)
    frame = next(airgs.decode_frames(package, 0, 1))
    camera, log = package.cameras[0], airgs.simulate(package, "const:5")
    picture = airgs.draw(frame.gaussians, camera)
    assert picture._repr_png_().startswith(b"\x89PNG")
    compared = airgs.compare(sequence, sequence, frames=range(1))
    things = package, sequence, frame, camera, log, picture, compared, airgs.Trace.open("markov:1"), sequence[:3]
    return {type(thing).__name__: thing for thing in (*things, airgs.decide(FOX, FAST))}


KINDS = [
    "Package", "GaussianSequence", "Plan", "Frame", "Camera", "SessionLog", "Render", "Comparison", "Trace",
    "LazyFrames",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_returned_can_be_pickled_and_is_shown_in_a_line(public, kind):
    thing = public[kind]
    copy = pickle.loads(pickle.dumps(thing))
    assert repr(copy) == repr(thing) and len(repr(thing)) < 300 and "array(" not in repr(thing)
    if kind == "Package":
        assert (airgs.decode(copy, 3).means == airgs.decode(thing, 3).means).all()
    if kind == "SessionLog":
        assert copy.metrics == thing.metrics and copy.events == thing.events


def test_the_rungs_of_a_package_have_names_bytes_and_psnr(public):
    package = public["Package"]
    summary, frames = summarise(package.manifest, package.manifest_bytes)["rungs"], package.manifest.frames
    assert [rung.name for rung in package.rungs] == ["Q0+L0", "Q0+L1", "Q1+L0", "Q1+L1"]
    expected = [(round(r["bytes_per_frame"] * frames), r["psnr"], r["best"]) for r in summary]
    assert [(r.bytes, r.psnr, r.best) for r in package.rungs] == expected


def test_a_sequence_is_like_a_list(public):
    sequence = public["GaussianSequence"]
    firsts = [g.means[0, 0] for g in sequence]
    assert firsts == [sequence.read(n).means[0, 0] for n in range(len(sequence))]
    assert sequence[-1].means[0, 0] == firsts[-1] and sequence[np.int64(2)].means[0, 0] == firsts[2]
    assert [g.means[0, 0] for g in sequence[7:2:-2]] == firsts[7:2:-2]


class Bars(tqdm):
    made: ClassVar = []

    def __init__(self, *arguments, **named):
        super().__init__(*arguments, **named)
        Bars.made.append(self)


def test_a_class_of_bars_shows_one_for_each_stage_whose_end_may_move(capsys):
    Bars.made.clear()
    progress = as_reporter(Bars)
    for stage, done, total in [("a", 1, 4), ("a", 2, 4), ("b", 0, 3), ("b", 1, 5), ("b", 5, 5), ("b", 1, 2)]:
        progress(stage, done, total)
    assert [(bar.desc.strip(": "), bar.n, bar.total) for bar in Bars.made] == [("a", 2, 4), ("b", 5, 5), ("b", 1, 2)]
    assert [bar.disable for bar in Bars.made] == [True, True, False]  # tqdm's mark of a closed bar
    progress.close()


def test_a_path_is_encoded_repaired_with_its_attribution_and_decoded_by_names_or_numbers(tmp_path, capsys):
    Bars.made.clear()
    frames, told_of = moving_frames(60, 2), []
    scene = write_sequence(tmp_path / "scene", frames)
    (scene / "ATTRIBUTION.txt").write_text("points by nobody\n")
    quaternions, means = frames[1].quaternions.copy(), frames[1].means.copy()
    quaternions[3], means[4] = 0, np.nan
    write_ply(scene / "000001.ply", replace(frames[1], quaternions=quaternions, means=means))
    airgs.encode(str(scene), str(tmp_path / "a.airgs"), FAST, progress=Bars)
    package = airgs.open_package(str(tmp_path / "a.airgs"))
    assert package.manifest.attribution == "points by nobody" and airgs.validate(tmp_path / "a.airgs") == []
    repaired = " ".join(package.manifest.groups[0].repairs)
    assert "1 Gaussians that are not finite" in repaired and "1 Gaussians with zero quaternions" in repaired
    by_name, by_number = (airgs.decode(package, 1, level=j, keyframe_quality=q) for j, q in (("L2", "Q1"), (2, 1)))
    assert isinstance(by_name, airgs.Gaussians) and (by_name.means == by_number.means).all()
    seen = airgs.Sequence.from_arrays(frames, cameras=[airgs.Camera.look_at((0, 0, -4), (0, 0, 0), size=(64, 48))])
    assert airgs.compare(package, str(tmp_path / "a.airgs"), frames=range(1)).quality.psnr == 100
    airgs.compare(seen, tmp_path / "a.airgs", progress=lambda *told: told_of.append(told))
    assert Bars.made and all(bar.n == bar.total for bar in Bars.made)
    assert told_of[-1] == ("comparing", 2, 2)


def test_encoding_is_one_stage_that_ends_where_it_was_said_to(tmp_path):
    told_of = []
    sequence = airgs.Sequence.from_arrays(moving_frames(60, 4))
    settings = replace(FAST, measure_pictures=1, decide_pictures=2, group_frames=2)
    airgs.encode(sequence, tmp_path / "a.airgs", settings, progress=lambda *words: told_of.append(words))
    encoding = [words for words in told_of if words[0].startswith("encoding")]
    assert {name for name, _, _ in encoding} >= {"encoding: frames 0-1", "encoding: frames 2-3", "encoding"}
    done, totals = zip(*[words[1:] for words in encoding], strict=True)
    assert list(done) == sorted(done) and list(totals) == sorted(totals) and done[-1] == totals[-1]


WITHOUT_EXTRAS = """
import sys
for name in ("torch", "gsplat"):
    sys.modules[name] = None  # an import of it fails as where it is not installed
from airgs_codec.cli import decode, encode, manifest, play, train
options = ["--calibrate", "none", "--measure-pictures", "2", "--x264-preset", "ultrafast"]
assert encode.main(["scene", "-o", "scene.airgs", *options]) == 0
assert decode.main(["scene.airgs", "-o", "decoded"]) == 0
assert manifest.main(["validate", "scene.airgs", "--against", "scene"]) == 0
assert manifest.main(["inspect", "scene.airgs"]) == 0
assert play.main(["scene.airgs", "--trace", "const:5"]) == 0
assert play.main(["scene.airgs", "--trace", "const:5", "--report", "report"]) == 0
assert manifest.main(["inspect", "scene.airgs", "--plot", "plot.png"]) == 0
assert train.main(["scene", "-o", "model"]) == 2
"""


def test_all_but_training_works_without_the_extras(tmp_path):
    write_sequence(tmp_path / "scene", moving_frames(300, 3))
    said = [line for line in python(tmp_path, "-c", WITHOUT_EXTRAS).splitlines() if "pip install" in line]
    assert len(said) == 1 and "train" in said[0]


def smallest(state):
    return airgs.Decision(min(state.options, key=lambda o: o.size_bytes).index)


@pytest.mark.parametrize("of", [str, lambda path: path])
def test_a_path_opens_what_is_expected_and_a_function_is_a_policy(of):
    opened = airgs.decode(airgs.open_package(PACKAGE), 1)
    assert (airgs.decode(of(PACKAGE), 1).means == opened.means).all()
    same = airgs.simulate(airgs.open_package(PACKAGE), airgs.Trace.open("const:5"), "bola")
    assert airgs.simulate(of(PACKAGE), "const:5", "bola").metrics == same.metrics
    log = airgs.simulate(of(PACKAGE), "const:5", smallest)
    assert log.policy == "smallest" and log.metrics.frames


@pytest.mark.parametrize("call", [
    *(partial(SEQUENCE.__getitem__, n) for n in (99, -99, "0")), *(partial(SEQUENCE.read, n) for n in (99, -1)),
    *(partial(SEQUENCE.load, n) for n in ([0, 99], [], 3)), *(partial(airgs.decode, PACKAGE, n) for n in (99, -1)),
    partial(SEQUENCE[:2].__getitem__, 2), lambda: list(airgs.decode_frames(PACKAGE, 0, 99)),
])  # fmt: skip
def test_a_frame_that_is_not_there_is_named_alike_everywhere(call):
    with pytest.raises(airgs.AirgsError, match=r"^frames?: expected") as caught:
        call()
    assert isinstance(caught.value, IndexError) and "\n" not in str(caught.value)


def gaussians(name, value):
    """A call for five Gaussians, one of whose arrays is this."""
    widths = {"means": 3, "quaternions": 4, "log_scales": 3, "sh_dc": 3}
    arrays = {column: np.zeros((5, width), np.float32) for column, width in widths.items()}
    arrays |= {"opacity_logits": np.zeros(5, np.float32), "sh_rest": np.zeros((5, 8, 3), np.float32)}
    assert len(airgs.Gaussians(**arrays)) == 5
    return partial(airgs.Gaussians, **arrays | {name: value})


@pytest.mark.parametrize(("call", "line"), [
    (partial(airgs.decode, 3, 0), "package: expected an open package or the path of one, got int 3"),
    (partial(airgs.decode, PACKAGE, "0"), r"frame: expected 0\.\.\d+, got '0'"),
    (partial(airgs.decode, PACKAGE, 0, level=None), "level: expected one of L0.*, got None"),
    (partial(airgs.encode, None, "x.airgs"), "sequence: expected an open sequence or the path of one, got None"),
    (partial(airgs.encode, FOX, "x.airgs", {"quality": 1}), "settings: expected EncodeSettings, got dict"),
    (partial(airgs.encode, FOX, "x.airgs", goal=40), "goal: expected a Goal, got int 40"),
    (partial(airgs.encode, FOX, 3), "path: expected a path or an address, got int 3"),
    (partial(airgs.open_package, None), "path: expected a path or an address, got None"),
    (partial(airgs.open_sequence, [1, 2]), r"folder: expected a path or an address, got list \[1, 2\]"),
    (partial(airgs.compare, FOX, FOX, frames=range(99)), r"frames: expected some of range\(0, 10\), got .*\(0, 99\)"),
    (partial(airgs.Trace.open, 5), "trace: expected a path or an address, got int 5"),
    (partial(airgs.validate, None), "path: expected a path or an address, got None"),
    (partial(airgs.simulate, [], "const:5"), r"package: expected an open package or .* of one, got list \[\]"),
    (partial(airgs.simulate, PACKAGE, 5.0), r"trace: expected a trace, or its path or name, got float 5\.0"),
    (partial(SIMULATE, "best"), "^policy: expected paper.* got 'best'"),
    (partial(airgs.draw, None, None, "tpu"), "^device: expected auto, cpu, cuda, got 'tpu'"),
    (partial(airgs.EncodeSettings, quality="high"), "^quality: expected a number, got str 'high'"),
    (partial(airgs.EncodeSettings, quality=1e-320), "step factors"),
    (partial(airgs.EncodeSettings, group_frames=2.5), "^group_frames: expected a whole number, got float 2.5"),
    (partial(airgs.EncodeSettings, tiers=1), "^tiers: expected a tuple, got int 1"),
    (partial(airgs.EncodeSettings, margin=True), "^margin: expected a number or None, got bool True"),
    (partial(airgs.SessionSettings, loops=10**99), "^loops: expected a whole number or None, got int 1000"),
    (partial(airgs.TrainSettings, seed="1"), "^seed: expected a whole number, got str '1'"),
    (partial(airgs.Goal, "psnr", 40), "^metric: expected a metric, as of Goal.psnr"),
    (partial(airgs.Goal.size, "12"), "^target: expected a number, got str '12'"),
    (partial(SIMULATE, 3), "policy: expected a name, a function .* got int 3"),
    (partial(SIMULATE, settings=3), "settings: expected SessionSettings, got int 3"),
    (partial(SIMULATE, lambda state: state.options[0]), "policy <lambda>: expected a Decision, got Option"),
    (partial(SIMULATE, lambda state: airgs.Decision(99)), "expected the index of one of .* got 99"),
    (gaussians("means", np.zeros((5, 4))), r"means: expected an array of shape \(N, 3\), got \(5, 4\)"),
    (gaussians("means", np.zeros(())), r"means: expected .*, got \(\)"),
    (gaussians("quaternions", np.zeros((4, 4))), r"quaternions: expected an array of shape \(5, 4\), got \(4, 4\)"),
    (gaussians("opacity_logits", np.zeros((5, 1))), r"opacity_logits: expected an array of shape \(5,\), got \(5, 1\)"),
    (gaussians("sh_rest", np.zeros((5, 4, 3))), r"sh_rest: .* \(5, K, 3\) with K of 0, 3, 8 or 15, got \(5, 4, 3\)"),
    (gaussians("sh_dc", [[0, 0, 0]]), "sh_dc: expected an array .*, got list"),
])  # fmt: skip
def test_what_is_of_no_use_is_refused_in_one_line(call, line):
    with pytest.raises(airgs.AirgsError, match=line) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_field_has_its_default_and_its_meaning_in_the_docstring():
    for settings in (airgs.EncodeSettings, airgs.SessionSettings, airgs.TrainSettings):
        for field in fields(settings):
            default = "" if field.default is MISSING else f" = {field.default!r}"
            told = f"{field.name}{default}: {field.metadata['help']}."
            assert field.metadata["help"] and "".join(told.split()) in "".join(settings.__doc__.split())
