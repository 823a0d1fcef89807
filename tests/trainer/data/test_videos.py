"""Videos: upright as every player shows them, and joined by the times of their pictures."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from airgs_codec.cli.train import match_cameras
from airgs_codec.trainer.data.sync import in_step
from tests.faces import (
    Capture,
    Pictures,
    SceneError,
    TrainSettings,
    airgs_train,
    open_run,
    open_scene,
    rested,
    with_held_out,
)
from tests.support.multiview_files import plain, write_filmed
from tests.support.views import ring

CAMERA = replace(ring(1)[0], width=32, height=48)
UPRIGHT = np.zeros((48, 32, 3), np.uint8)
UPRIGHT[:24, :16], UPRIGHT[:24, 16:], UPRIGHT[24:, :16] = 200, 130, 60  # every corner its own grey
TURNS = [  # a, b, c, d of a display matrix, and how that is undone
    ((1, 0, 0, 1), lambda picture: picture),
    ((0, 1, -1, 0), np.rot90),  # players turn it clockwise
    ((-1, 0, 0, -1), lambda picture: np.rot90(picture, 2)),
    ((0, -1, 1, 0), lambda picture: np.rot90(picture, 3)),
    ((-1, 0, 0, 1), np.fliplr),
    ((0, 1, 1, 0), lambda picture: picture.transpose(1, 0, 2)),
]


def turned(a, b, c, d):
    """What gives the track of an .mp4 a display matrix."""

    def change(path):
        there, wanted = (
            struct.pack(">9i", *(int(v * (1 << 16)) for v in m), 0, 0, 0, 1 << 30)
            for m in ((1, 0, 0, 0, 1), (a, b, 0, c, d))
        )
        path.write_bytes(wanted.join(path.read_bytes().rsplit(there, 1)))

    return change


@pytest.mark.parametrize(("matrix", "undone"), TURNS)
def test_pictures_are_upright_and_it_is_said(tmp_path, matrix, undone):
    write_filmed(tmp_path, CAMERA, {"cam.mp4": ([np.ascontiguousarray(undone(UPRIGHT))] * 3, range(3))})
    turned(*matrix)(tmp_path / "cam.mp4")
    scene = open_scene(tmp_path)
    assert np.abs(Pictures(scene).train(2)[0].target.rgb * 255 - UPRIGHT).max() < 4
    said = ["3 frames of 25 a second, joined by time; turned upright: cam"]
    assert list(scene.notes) == ([] if matrix == (1, 0, 0, 1) else said)


def greys(scene):
    """The grey of each camera's picture of each frame, by tens."""
    pictures = Pictures(scene)
    seen = [pictures.train(frame) for frame in range(len(scene))]
    return [{view.camera.name: round(float(view.target.rgb.mean()) * 25.5) for view in views} for views in seen]


def filmed(folder, a, b, suffix=".mp4"):
    """Two cameras whose pictures at each time, in frames, are of a grey that tells the time."""
    films = {
        f"{name}{suffix}": ([plain(20 + 10 * round(t), (32, 48)) for t in times], times)
        for name, times in {"a": a, "b": b}.items()
    }
    return write_filmed(folder, CAMERA, films)


NINE = range(9)
RIGS = [  # times of two cameras, and those of the frames in which one of them has a picture
    ("2 of 9 frames dropped: b", NINE, [0, 1, 2, 5, 6, 7, 8], NINE),
    ("begins 0.12 s late: b; left out are 3 of 9 frames", NINE, range(3, 9), range(3, 9)),
    ("left out are 4 of 9 frames", NINE, range(5), range(5)),
    ("1 of 5 frames dropped: a, b", [0, 2, 3, 4], [0, 1, 2, 4], range(5)),
    ("left out are 2 of 6 frames, which no camera has", [0, 1, 4, 5], [0, 1, 4, 5], [0, 1, 4, 5]),
    ("rate varies, pictures are up to 0.3 frames off and 0 too many: b", NINE, [0, 1.3, 2, 2.7, *range(4, 9)], NINE),
    ("rate varies, pictures are up to 0.2 frames off and 1 too many: b", NINE, [0, 1, 2, 2.2, *range(3, 9)], NINE),
]


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize(("note", "a", "b", "seen"), RIGS)
def test_a_rig_is_joined_by_time_and_a_hole_is_a_hole(tmp_path, suffix, note, a, b, seen):
    scene = open_scene(filmed(tmp_path, a, b, suffix))
    shown = {"a": {round(t) for t in a}, "b": {round(t) for t in b}}
    assert greys(scene) == [{name: 2 + t for name, times in shown.items() if t in times} for t in seen]
    assert note in scene.notes[0] and scene.fps == 25


def cut_off(path):
    path.write_bytes(path.read_bytes()[:-9])


BROKEN = [
    (".mp4", range(3), turned(0, 1, -1, 0), "b.mp4: expected pictures of 32x48, got 48x32"),
    (".mp4", range(3), turned(0.6, 0.8, -0.8, 0.6), "b.mp4: expected pictures turned by right angles, got -53 deg"),
    (".mp4", range(9, 12), None, "expected videos of one time, they begin up to 9 frames apart"),
    (".mp4", [0, 1.2, 2.4, 3.6], None, "expected videos of one frame rate, got 20.8333, 25"),
    (".mkv", [0, 0.01, 1], None, "b.mkv: expected pictures at times of their own, got several at one"),
    (".mp4", range(9), cut_off, "b.mp4: expected a whole video, picture 8 is cut off"),
]


@pytest.mark.parametrize(("suffix", "b", "change", "message"), BROKEN)
def test_what_cannot_be_joined_is_refused_in_one_line(tmp_path, capsys, suffix, b, change, message):
    filmed(tmp_path, range(5), b, suffix)
    if change:
        change(tmp_path / f"b{suffix}")
    assert airgs_train([str(tmp_path), "-o", str(tmp_path / "m")]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1


def test_a_rig_with_holes_has_plates_and_offsets_and_says_what_it_lacks(tmp_path, capsys):
    scene = open_scene(filmed(tmp_path, range(9), [0, 1, 3, 4, 6, 7, 8]))
    match_cameras(scene, (0, None), "auto", None, quiet=False)
    assert capsys.readouterr().out == f"{tmp_path}: 9 frames of 25 a second, joined by time; 2 of 9 frames dropped: b\n"
    capture = rested(Capture.of(scene, TrainSettings(), "cpu"))
    assert set(capture.plates) == {"a", "b"}
    assert [len(capture.target(t, t - 1).moving) for t in (1, 2, 3)] == [2, 1, 2]
    late = in_step(scene, {"a": 2.25})  # a begins to be behind, with what both have
    assert [len(shots) for shots in late.frames] == [2, 2, 1, 2, 2, 1]
    with pytest.raises(SceneError, match="pictures of all cameras at frame 2, where training begins"):
        in_step(scene, {}, (2, None))
    with pytest.raises(SceneError, match="expected training views of frame 2, got none"):
        open_run(with_held_out(scene, ["a"]), tmp_path / "m", TrainSettings())


@pytest.mark.parametrize("suffix", [".jpg", ".webp", ".png", ".tif"])
def test_pictures_stay_as_they_are_stored_whatever_their_exif_says(moving, suffix):
    path = moving / "images" / "cam01" / "0000.png"
    with Image.open(path) as picture:
        exif = picture.getexif()
        exif[0x0112] = 6
        picture.save(path.with_suffix(suffix), exif=exif)
    text = (moving / "transforms.json").read_text()
    (moving / "transforms.json").write_text(text.replace("cam01/0000.png", f"cam01/0000{suffix}"))
    scene = open_scene(moving)
    if suffix == ".tif":
        with pytest.raises(SceneError, match="stored as it is shown, got a TIFF with an orientation"):
            Pictures(scene).check()
    else:
        assert scene.notes == ("pictures are taken as they are stored, not as their EXIF orientation has it: cam01",)
