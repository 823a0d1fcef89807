"""Sequences of frames that a program has: as arrays, with the same result as from files, and refused by name."""

import gc
import pickle

import numpy as np
import pytest
import torch

import airgs_codec as airgs
from tests.support.scenes import moving_frames, write_sequence

FRAMES = moving_frames(60, 3, degree=1)
NAMES = FRAMES[0].__slots__
CAMERAS = [airgs.Camera.look_at((0, 0, -4), (0, 0, 0), size=(64, 48))]
GSPLAT = ("means", "quats", "scales", "opacities", "sh0", "shN")  # its names of the same


def stacked():
    return {name: np.stack([getattr(frame, name) for frame in FRAMES]) for name in NAMES}


def same(sequence):
    return [(getattr(sequence.read(t), name) == getattr(FRAMES[t], name)).all() for t in range(3) for name in NAMES]


def tensors():
    return {name: torch.tensor(column, requires_grad=True) for name, column in stacked().items()}


def as_in_gsplat():
    found = dict(zip(GSPLAT, stacked().values(), strict=True))
    return found | {"sh0": found["sh0"][:, :, None]}


MAKERS = {
    "gsplat": as_in_gsplat, "torch": tensors, "Gaussians": lambda: FRAMES, "iterator": lambda: iter(FRAMES),
    "mappings": lambda: [frame.columns() for frame in FRAMES],
    "time axis": lambda: {name: column.astype(np.float64) for name, column in stacked().items()},
}  # fmt: skip


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_frames_are_those_that_were_given_and_sh_past_dc_may_be_left_out(make):
    sequence = airgs.Sequence.from_arrays(make(), fps=24, cameras=CAMERAS)
    assert (len(sequence), sequence.fps, sequence.sh_degree) == (3, 24, 1)
    assert all(same(sequence)) and all(same(pickle.loads(pickle.dumps(sequence))))
    without = {name: column for name, column in FRAMES[0].columns().items() if name != "sh_rest"}
    assert airgs.Sequence.from_arrays([without]).sh_degree == 0


@pytest.mark.parametrize("make", [iter, list])
def test_frames_of_iterators_and_for_other_processes_lie_in_a_folder_that_goes(make, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    sequence = airgs.Sequence.from_arrays(make(FRAMES))
    assert any(tmp_path.iterdir()) == (make is iter)
    copy = pickle.loads(pickle.dumps(sequence))
    assert pickle.dumps(sequence) == pickle.dumps(sequence) and all(same(copy))
    assert len(list(tmp_path.glob("*/*.ply"))) == 3
    del copy
    assert all(same(sequence))
    del sequence
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_an_encode_would_read_the_same_as_of_files(tmp_path):
    filed = airgs.open_sequence(write_sequence(tmp_path, FRAMES, cameras=False), fps=24)
    held = airgs.Sequence.from_arrays(FRAMES, fps=24)
    for name in ("headers", "fps", "keyframes", "cameras", "background", "notes", "origin", "attribution", "breaks"):
        assert getattr(filed, name) == getattr(held, name)
    for a, b in zip(filed.load(range(3)).frames, held.load(range(3)).frames, strict=True):
        assert all((getattr(a, name) == getattr(b, name)).all() for name in NAMES)


@pytest.mark.parametrize("make", [tensors, as_in_gsplat])
def test_a_frame_of_other_arrays_is_drawn_and_written_and_gaussians_of_tensors_are_arrays(make, tmp_path):
    frame = {name: column[0] for name, column in make().items()}
    airgs.write(frame, tmp_path / "frame.ply")
    assert (airgs.read(tmp_path / "frame.ply").means == FRAMES[0].means).all()
    assert (airgs.draw(frame, CAMERAS[0]).rgb == airgs.draw(FRAMES[0], CAMERAS[0]).rgb).all()
    made = airgs.Gaussians(**{name: column[0] for name, column in tensors().items()})
    assert all(getattr(made, name).dtype == np.float32 for name in NAMES)


def changed(**others):
    return [FRAMES[0], FRAMES[1].columns() | others]


MEANS, SCALES = (getattr(FRAMES[1], name).copy() for name in ("means", "log_scales"))
MEANS[7], SCALES[7] = np.nan, np.inf
GIVEN = [
    ([], "frames: expected at least one, got none"),
    (5, "frames: expected .*, got int 5"),
    (FRAMES[0], "frames: expected .*, got Gaussians"),
    ([FRAMES[0], "x.ply"], "frame 1: expected Gaussians or a mapping of their arrays, got str 'x.ply'"),
    ([{"means": np.zeros((5, 3))}], "frame 0: expected means, quaternions.* and maybe sh_rest, got means"),
    (changed(colours=np.zeros(3)), "frame 1: expected means.*, got means.*, colours"),
    (changed(means="here"), "frame 1: means: expected an array of numbers"),
    (changed(quaternions=np.zeros((60, 3))), r"frame 1: quaternions: expected .*\(60, 4\), got \(60, 3\)"),
    (changed(sh_rest=np.zeros((60, 0, 3))), "frame 1: sh_rest: expected SH degree 1 as in frame 0, got 0"),
    (changed(log_scales=SCALES), "frame 1: log_scales: expected finite numbers, got inf in row 7"),
    (changed(means=MEANS), "frame 1: means: expected finite numbers, got nan in row 7"),
    (as_in_gsplat() | dict.fromkeys(("scales", "opacities"), np.ones((3, 60, 3))),
     "frames: scales, opacities: expected logarithms"),
    ([FRAMES[0].take(slice(0, 0))], "frame 0: expected at least one Gaussian, got none"),
    (FRAMES[0].columns(), r"means: expected an array of shape \(T, N, 3\), got \(60, 3\)"),
    (stacked() | {"sh_dc": np.zeros((2, 60, 3))}, r"sh_dc: expected 3 frames as of means, got the shape \(2, 60, 3\)"),
]  # fmt: skip


@pytest.mark.parametrize(("frames", "line"), GIVEN)
def test_what_cannot_be_is_refused_by_frame_and_argument(frames, line):
    with pytest.raises(airgs.AirgsError, match=f"^{line}") as caught:
        airgs.Sequence.from_arrays(frames)
    assert "\n" not in str(caught.value)


def test_other_arguments_and_arrays_of_gaussians_are_checked():
    for more in ({"fps": 0}, {"fps": "30"}, {"cameras": ["front"]}):
        with pytest.raises(airgs.AirgsError, match=r"fps|cameras"):
            airgs.Sequence.from_arrays(FRAMES, **more)
    with pytest.raises(airgs.AirgsError, match=r"^means: expected an array of numbers"):
        airgs.Gaussians(**FRAMES[0].columns() | {"means": np.full((60, 3), "x")})
