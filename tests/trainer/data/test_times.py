"""Times of pictures: videos are joined by them, and cameras that are not in step are found and matched."""

import math
import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from airgs_codec.trainer.data import multiview, sync
from tests import faces
from tests.faces import Capture, MultiviewScene, Pictures, SceneError, Shot, TrainSettings, open_scene, rested
from tests.support.multiview_files import plain, write_filmed
from tests.support.views import ring

CAMERA = replace(ring(1)[0], width=32, height=48)
UPRIGHT = np.zeros((48, 32, 3), np.uint8)
UPRIGHT[:24, :16], UPRIGHT[:24, 16:], UPRIGHT[24:, :16] = 200, 130, 60  # every corner its own grey


def turn(path, *matrix):
    fixed = ([int(v * (1 << 16)) for v in (a, b, 0, c, d)] for a, b, c, d in ((1, 0, 0, 1), matrix))
    there, wanted = (struct.pack(">9i", *numbers, 0, 0, 0, 1 << 30) for numbers in fixed)
    path.write_bytes(wanted.join(path.read_bytes().rsplit(there, 1)))


@pytest.mark.parametrize(("matrix", "undone"), [  # a, b, c, d of a display matrix, and how that is undone
    (( 1,  0,  0,  1), lambda picture: picture),
    (( 0,  1, -1,  0), np.rot90),  # players turn it clockwise
    ((-1,  0,  0, -1), lambda picture: np.rot90(picture, 2)),
    (( 0, -1,  1,  0), lambda picture: np.rot90(picture, 3)),
    ((-1,  0,  0,  1), np.fliplr),
    (( 0,  1,  1,  0), lambda picture: picture.transpose(1, 0, 2)),
])  # fmt: skip
def test_pictures_are_upright_and_it_is_said(tmp_path, matrix, undone):
    write_filmed(tmp_path, CAMERA, {"cam.mp4": ([np.ascontiguousarray(undone(UPRIGHT))] * 3, range(3))})
    turn(tmp_path / "cam.mp4", *matrix)
    scene = open_scene(tmp_path)
    assert np.abs(Pictures(scene).train(2)[0].target.rgb * 255 - UPRIGHT).max() < 4
    said = ["3 frames of 25 a second, joined by time; turned upright: cam"]
    assert list(scene.notes) == ([] if matrix == (1, 0, 0, 1) else said)


def filmed(folder, a, b, suffix=".mp4"):
    """Two cameras whose pictures at each time, in frames, are of a grey that tells the time."""
    rig = {f"a{suffix}": a, f"b{suffix}": b}
    films = {name: ([plain(20 + 10 * round(t), (32, 48)) for t in times], times) for name, times in rig.items()}
    return write_filmed(folder, CAMERA, films)


NINE = range(9)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize(("note", "a", "b", "seen"), [  # times of two cameras, and of frames that one of them has
    ("2 of 9 frames dropped: b", NINE, [0, 1, 2, 5, 6, 7, 8], NINE),
    ("begins 0.12 s late: b; left out are 3 of 9 frames", NINE, range(3, 9), range(3, 9)),
    ("left out are 4 of 9 frames", NINE, range(5), range(5)),
    ("1 of 5 frames dropped: a, b", [0, 2, 3, 4], [0, 1, 2, 4], range(5)),
    ("left out are 2 of 6 frames, which no camera has", [0, 1, 4, 5], [0, 1, 4, 5], [0, 1, 4, 5]),
    ("rate varies, pictures are up to 0.3 frames off and 0 too many: b", NINE, [0, 1.3, 2, 2.7, *range(4, 9)], NINE),
    ("rate varies, pictures are up to 0.2 frames off and 1 too many: b", NINE, [0, 1, 2, 2.2, *range(3, 9)], NINE),
])  # fmt: skip
def test_a_rig_is_joined_by_time_and_a_hole_is_a_hole(tmp_path, suffix, note, a, b, seen):
    scene = open_scene(filmed(tmp_path, a, b, suffix))
    shown = {"a": {round(t) for t in a}, "b": {round(t) for t in b}}
    pictures = Pictures(scene)
    for frame, t in enumerate(seen):
        greys = {view.camera.name: round(float(view.target.rgb.mean()) * 25.5) for view in pictures.train(frame)}
        assert greys == {name: 2 + t for name, times in shown.items() if t in times}
    assert len(scene) == len(seen)
    assert note in scene.notes[0] and scene.fps == 25


@pytest.mark.parametrize(("suffix", "b", "change", "message"), [
    (".mp4", range(3), lambda path: turn(path, 0, 1, -1, 0), "b.mp4: expected pictures of 32x48, got 48x32"),
    (".mp4", range(3), lambda path: turn(path, 0.6, 0.8, -0.8, 0.6),
     "b.mp4: expected pictures turned by right angles, got -53 deg"),
    (".mp4", range(9, 12), None, "expected videos of one time, they begin up to 9 frames apart"),
    (".mp4", [0, 1.2, 2.4, 3.6], None, "expected videos of one frame rate, got 20.8333, 25"),
    (".mkv", [0, 0.01, 1], None, "b.mkv: expected pictures at times of their own, got several at one"),
    (".mp4", range(9), lambda path: path.write_bytes(path.read_bytes()[:-9]),
     "b.mp4: expected a whole video, picture 8 is cut off"),
])  # fmt: skip
def test_what_cannot_be_joined_is_refused_in_one_line(tmp_path, capsys, suffix, b, change, message):
    filmed(tmp_path, range(5), b, suffix)
    if change:
        change(tmp_path / f"b{suffix}")
    assert faces.airgs_train([str(tmp_path), "-o", str(tmp_path / "m")]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1


def test_a_rig_with_holes_has_plates_and_offsets_and_says_what_it_lacks(tmp_path, capsys):
    scene = open_scene(filmed(tmp_path, range(9), [0, 1, 3, 4, 6, 7, 8]))
    faces.match_cameras(scene, (0, None), "auto", None, faces.Bar())
    assert capsys.readouterr().out == f"{tmp_path}: 9 frames of 25 a second, joined by time; 2 of 9 frames dropped: b\n"
    capture = rested(Capture.of(scene, TrainSettings(), "cpu"))
    assert set(capture.pictures.plates) == {"a", "b"}
    assert [len(capture.pictures.target(t, t - 1).moving) for t in (1, 2, 3)] == [2, 1, 2]
    late = sync.in_step(scene, {"a": 2.25})  # a begins to be behind, with what both have
    assert [len(shots) for shots in late.frames] == [2, 2, 1, 2, 2, 1]
    with pytest.raises(SceneError, match="pictures of all cameras at frame 2, where training begins"):
        sync.in_step(scene, {}, (2, None))
    with pytest.raises(SceneError, match="expected training views of frame 2, got none"):
        faces.open_run(faces.with_held_out(scene, ["a"]), tmp_path / "m", TrainSettings())


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


def names(scene):
    contents = faces.read_contents(scene)
    seen = (multiview.with_frames(scene, [frame]) for frame in range(len(scene)))
    return [faces.content_digest(faces.content_of(frame, contents)) for frame in seen]


def shaded(folder, *shades):
    folder.mkdir()
    pictures = [plain(shade, (32, 48)) for shade in shades]
    return open_scene(write_filmed(folder, CAMERA, {"a.mp4": (pictures, range(len(shades)))}))


def test_frames_of_a_video_have_names_of_their_own_wherever_it_lies(tmp_path):
    one, two, three = (tmp_path / name for name in ("one", "two", "three"))
    named = names(shaded(one, 10, 10, 90))
    assert len(set(named)) == 3  # by their number, though two show the same
    assert names(shaded(two, 10, 10, 90)) == named
    assert not set(names(shaded(three, 10, 10, 200))) & set(named)


def test_a_mask_is_a_file_and_counts_where_it_is_read(tmp_path):
    scene, mask = shaded(tmp_path / "one", 10, 20), tmp_path / "mask.png"

    def masked(path=mask):
        return replace(scene, frames=tuple((replace(shot, mask=Path(path)),) for (shot,) in scene.frames))

    plainly = names(scene)
    assert names(multiview.without_masks(masked())) == plainly
    for path, said in ((mask, "No such file"), ("a\0.png", ".*embedded null"), ("/dev/zero", ".*a device")):
        with pytest.raises(SceneError, match=f"expected a picture or a video: {said}") as caught:
            names(masked(path))
        assert path != mask or "mask.png: expected" in str(caught.value)
    mask.write_bytes(b"1")
    before = names(masked())
    mask.write_bytes(b"2")
    assert not set(before) & {*names(masked()), *plainly}


FRAMES = 20
SIZE = 96


def drawn(camera, time, still=False):
    """What a camera sees of three balls that hurry about, each in its own way, at a time in frames."""
    picture = np.full((SIZE, SIZE, 3), 40, np.uint8)
    for ball in range(0 if still else 3):
        phase = 0.55 * time / (1 + 0.4 * ball) + 2 * ball
        place = np.array([np.sin(phase), 0.7 * np.sin(1.7 * phase + ball), np.cos(0.8 * phase)]) * 0.9
        x, y, depth = camera.world_to_camera[:3, :3] @ place + camera.world_to_camera[:3, 3]
        at = (camera.fx * x / depth + camera.cx - 0.5, camera.fy * y / depth + camera.cy - 0.5)
        radius = 0.2 * camera.fx / depth
        cv2.circle(picture, [round(16 * v) for v in at], round(16 * radius), (220, 200, 90), -1, cv2.LINE_AA, shift=4)
    return picture


def balls(late, frames=FRAMES, still=False):
    """Six cameras all around, each late by so many frames, and a little noise."""
    rng = np.random.default_rng(0)

    def shown(camera, t):
        noisy = drawn(camera, t - late.get(camera.name, 0.0), still) + rng.normal(0, 1.5, (SIZE, SIZE, 3))
        picture = np.clip(noisy, 0, 255).astype(np.uint8)
        return Shot(camera, SimpleNamespace(read=lambda size: picture))

    shots = tuple(tuple(shown(camera, t) for camera in ring(6, SIZE)) for t in range(frames))
    return MultiviewScene(Path("balls"), Fraction(30), shots)


@pytest.mark.parametrize(("late", "more", "found"), [
    ({"cam01": 2.0, "cam02": -1.25, "cam04": 3.5}, {}, {"cam01": 2.0, "cam02": -1.25, "cam04": 3.5}),
    ({}, {}, {}),
    ({}, {"still": True}, {}),
    ({"cam01": 2.0}, {"frames": 11}, {}),  # too little is seen
])  # fmt: skip
def test_offsets_are_found_to_a_quarter_of_a_frame(late, more, found):
    assert sync.find_offsets(balls(late, **more)) == pytest.approx(found, abs=0.25)


def test_cameras_that_move_are_not_looked_at():
    scene = balls({"cam01": 2.0})
    turned = replace(scene.cameras[0], world_to_camera=scene.cameras[1].world_to_camera)
    first, *others = scene.frames[3]
    moving = replace(scene, frames=(*scene.frames[:3], (replace(first, camera=turned), *others), *scene.frames[4:]))
    assert sync.find_offsets(moving) == {}
    with pytest.raises(SceneError, match="stand still"):
        sync.in_step(moving, {"cam01": 2.0})


def test_a_scene_in_step_shows_each_camera_at_its_own_time():
    late = {"cam01": 2.0, "cam02": -1.0}
    scene = balls(late)
    matched = sync.in_step(scene, late)
    assert len(matched) == FRAMES - 3 and matched.offsets == late
    # As many as are wanted, from the first that all cameras have.
    assert sync.in_step(scene, late, (0, 4)).frames == matched.frames[:4]
    assert len(sync.in_step(scene, late, (FRAMES - 6, None))) == 4
    assert sync.in_step(scene, {}, (2, 5)).frames == scene.frames[2:5]
    with pytest.raises(SceneError, match="frames inside"):
        sync.in_step(scene, late, (3, FRAMES + 1))
    assert matched.frames[0][0] is scene.frames[1][0]  # frame 0 of the first camera would be frame -1 of cam02
    assert matched.frames[0][1] is scene.frames[3][1] and matched.frames[0][2] is scene.frames[0][2]
    assert matched.frames[-1][1] is scene.frames[-1][1]
    assert sync.find_offsets(matched) == {}
    assert sync.in_step(scene, {"cam01": 0.0}).frames == scene.frames


def files(folder):
    """A scene of pictures in files: two cameras, five frames, brighter with time."""

    def shot(camera, t):
        path, mask = folder / f"{camera.name}-{t}.png", folder / f"mask-{camera.name}-{t}.png"
        faces.write_png(path, plain(20 * t + 10, (32, 32)))
        faces.write_png(mask, plain(255, (32, 32)))
        return Shot(camera, multiview.Source(path), None, mask)

    frames = tuple(tuple(shot(camera, t) for camera in ring(2, 32)) for t in range(5))
    return MultiviewScene(folder, Fraction(30), frames)


def test_a_fraction_of_a_frame_takes_the_next_picture_and_says_when_it_was_taken(tmp_path):
    scene = files(tmp_path)
    for offset, next_one, after in ((0.75, 2, 0.25), (0.25, 2, 0.75), (0.5, 2, 0.5), (-0.5, 1, 0.5), (-1.0, 0, 0.0)):
        matched = sync.in_step(scene, {"cam01": offset}, (0, 5))
        first = math.ceil(max(0.0, -offset))
        shot = matched.frames[1 - first][1]
        assert (shot.source.path.name, shot.after) == (f"cam01-{next_one}.png", after)
        assert shot.mask == tmp_path / f"mask-cam01-{next_one}.png" and matched.frames[0][0].after == 0.0
        assert Pictures(matched).view(1 - first, 1).after == after
    contents = faces.read_contents(scene)
    pair = (sync.in_step(scene, {"cam01": offset}) for offset in (0.75, 0.625))  # the same files, and masks
    one, other = (faces.content_of(matched, contents)[2][1] for matched in pair)
    assert one != other


def test_offsets_that_cannot_be(tmp_path):
    for offsets, message in (({"cam09": 1}, "no camera cam09"), ({"cam01": 5}, "leave a frame of 5 to all cameras")):
        with pytest.raises(SceneError, match=message):
            sync.in_step(files(tmp_path), offsets)
    path = tmp_path / "offsets.json"
    for text in ("[1]", '{"cam01": "2"}', '{"cam01": NaN}', '{"cam01": true}', "{"):
        path.write_text(text)
        with pytest.raises(SceneError, match=r"offsets\.json"):
            sync.read_offsets(path)
    path.write_text('{"cam01": -2}')
    assert sync.read_offsets(path) == {"cam01": -2.0}
