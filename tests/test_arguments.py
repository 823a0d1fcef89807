"""What is given to public functions: a path opens what is at it, and what is of no use is refused in one line."""

from functools import partial

import numpy as np
import pytest

import airgs_codec as airgs
from tests.support.paths import FOX, GOLDEN

PACKAGE = GOLDEN / "fox"
FAST = airgs.EncodeSettings(calibrate="none", measure_pictures=0, preset="ultrafast")


def smallest(state):
    return airgs.Decision(min(state.options, key=lambda o: o.size_bytes).index)


@pytest.mark.parametrize("of", [str, lambda path: path])
def test_a_path_opens_what_is_expected(of):
    opened = airgs.decode(airgs.open_package(PACKAGE), 1)
    assert (airgs.decode(of(PACKAGE), 1).means == opened.means).all()
    same = airgs.simulate(airgs.open_package(PACKAGE), airgs.Trace.open("const:5"), "bola")
    assert airgs.simulate(of(PACKAGE), "const:5", "bola").metrics == same.metrics


def test_a_folder_is_encoded_by_its_path(tmp_path):
    scene = tmp_path / "scene"
    scene.mkdir()
    (scene / "0.ply").write_bytes(next(iter(sorted(FOX.glob("*.ply")))).read_bytes())
    airgs.encode(str(scene), tmp_path / "scene.airgs", FAST)
    assert airgs.validate(tmp_path / "scene.airgs") == []


def test_a_function_is_a_policy():
    log = airgs.simulate(PACKAGE, "const:5", smallest)
    assert log.policy == "smallest" and log.metrics.frames


def simulate(*given, **more):
    return partial(airgs.simulate, *given, **more)


@pytest.mark.parametrize(
    "call",
    [
        lambda sequence: sequence[99],
        lambda sequence: sequence[-99],
        lambda sequence: sequence["0"],
        lambda sequence: sequence[:2][2],
        lambda sequence: sequence.read(99),
        lambda sequence: sequence.read(-1),
        lambda sequence: sequence.load([0, 99]),
        lambda sequence: sequence.load([]),
        lambda sequence: sequence.load(3),
        lambda sequence: airgs.decode(PACKAGE, 99),
        lambda sequence: airgs.decode(PACKAGE, -1),
        lambda sequence: list(airgs.decode_frames(PACKAGE, 0, 99)),
    ],
)
def test_a_frame_that_is_not_there_is_named_alike_everywhere(call):
    with pytest.raises(airgs.AirgsError, match=r"^frames?: expected") as caught:
        call(airgs.open_sequence(FOX))
    assert isinstance(caught.value, IndexError) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (partial(airgs.decode, 3, 0), "package: expected an open package or the path of one, got int 3"),
        (partial(airgs.decode, PACKAGE, "0"), r"frame: expected 0\.\.\d+, got '0'"),
        (partial(airgs.decode, PACKAGE, 0, level=None), "level: expected one of L0.*, got None"),
        (partial(airgs.encode, None, "x.airgs"), "sequence: expected an open sequence or the path of one, got None"),
        (partial(airgs.encode, FOX, "x.airgs", {"quality": 1}), "settings: expected EncodeSettings, got dict"),
        (partial(airgs.encode, FOX, "x.airgs", goal=40), "goal: expected a Goal, got int 40"),
        (partial(airgs.encode, FOX, 3), "path: expected a path or an address, got int 3"),
        (partial(airgs.open_package, None), "path: expected a path or an address, got None"),
        (partial(airgs.open_sequence, [1, 2]), r"folder: expected a path or an address, got list \[1, 2\]"),
        (partial(airgs.Trace.open, 5), "trace: expected a path or an address, got int 5"),
        (partial(airgs.validate, None), "path: expected a path or an address, got None"),
        (simulate([], "const:5"), r"package: expected an open package or the path of one, got list \[\]"),
        (simulate(PACKAGE, 5.0), r"trace: expected a trace, or its path or name, got float 5\.0"),
        (simulate(PACKAGE, "const:5", "best"), "^policy: expected paper.* got 'best'"),
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
        (simulate(PACKAGE, "const:5", 3), "policy: expected a name, a function .* got int 3"),
        (simulate(PACKAGE, "const:5", settings=3), "settings: expected SessionSettings, got int 3"),
        (
            simulate(PACKAGE, "const:5", lambda state: state.options[0]),
            "policy <lambda>: expected a Decision, got Option",
        ),
        (
            simulate(PACKAGE, "const:5", lambda state: airgs.Decision(99)),
            "expected the index of one of .* got 99",
        ),
    ],
)
def test_what_is_of_no_use_is_refused_in_one_line(call, line):
    with pytest.raises(airgs.AirgsError, match=line) as caught:
        call()
    assert "\n" not in str(caught.value)


ARRAYS = {
    "means": (5, 3),
    "quaternions": (5, 4),
    "log_scales": (5, 3),
    "opacity_logits": (5,),
    "sh_dc": (5, 3),
    "sh_rest": (5, 8, 3),
}


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("means", np.zeros((5, 4)), r"means: expected an array of shape \(N, 3\), got \(5, 4\)"),
        ("means", np.zeros(()), r"means: expected .*, got \(\)"),
        ("quaternions", np.zeros((4, 4)), r"quaternions: expected an array of shape \(5, 4\), got \(4, 4\)"),
        ("opacity_logits", np.zeros((5, 1)), r"opacity_logits: expected an array of shape \(5,\), got \(5, 1\)"),
        ("sh_rest", np.zeros((5, 4, 3)), r"sh_rest: expected .* \(5, K, 3\) with K of 0, 3, 8 or 15, got \(5, 4, 3\)"),
        ("sh_dc", [[0, 0, 0]], "sh_dc: expected an array .*, got list"),
    ],
)
def test_gaussians_of_odd_shapes_are_refused(name, value, line):
    arrays = {key: np.zeros(shape, np.float32) for key, shape in ARRAYS.items()}
    assert len(airgs.Gaussians(**arrays)) == 5
    with pytest.raises(airgs.AirgsError, match=line):
        airgs.Gaussians(**arrays | {name: value})
