"""Masks that are found: what they show, where they lie, and when there are none."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.media.image import fit_lens, read_mask, undistort, write_png
from airgs_codec.media.masks import cut_out, distorted, filled, learn_colours, unlike_background, write_mask
from airgs_codec.render import render
from airgs_codec.trainer.data import foreground as data_foreground
from airgs_codec.trainer.data.foreground import Found, find_masks, with_found_masks
from airgs_codec.trainer.data.multiview import with_held_out
from airgs_codec.trainer.data.plates import Masks
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.pipeline import open_run
from tests.support.multiview_files import write_views
from tests.support.training import SETTINGS
from tests.support.views import coloured_cloud, moved, ring

FRAMES, SIZE = 6, 96
AUTO = replace(SETTINGS, foreground="auto")


def subject(t):
    """A ball that rolls to and fro."""
    ball = coloured_cloud(150)
    return moved(ball, slice(None), (0.35 * np.sin(2.1 * t), 0.0, 0.35 * np.cos(2.1 * t)))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The ball before walls with a grain, which cameras see with noise; the last of seven is held out."""
    folder, cameras = tmp_path_factory.mktemp("scene") / "ball", ring(7, SIZE, held_out=1)
    rng = np.random.default_rng(0)
    write_views(folder, [subject(t) for t in range(FRAMES)], cameras, None)
    for number, camera in enumerate(cameras):
        wall = rng.integers(90 + 3 * number, 130, (SIZE, SIZE, 1)).repeat(3, axis=2)
        for t in range(FRAMES):
            picture = 255 * render(subject(t), camera).rgb + clear(camera, t) * wall + rng.normal(0, 1.5, wall.shape)
            write_png(folder / "images" / camera.name / f"{t:04d}.png", np.clip(picture, 0, 255).astype(np.uint8))
    return open_scene(folder)


def clear(camera, t):
    """(H, W, 1) what is seen through the subject."""
    black, white = (render(subject(t), replace(camera, background=b)).rgb for b in ((0, 0, 0), (1, 1, 1)))
    return (white - black).mean(axis=2, keepdims=True)


def truth(camera, t):
    return clear(camera, t)[..., 0] < 0.5


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


@pytest.fixture(scope="module")
def masked(scene, tmp_path_factory):
    told = []
    folder = tmp_path_factory.mktemp("model") / "masks"
    return with_found_masks(scene, folder, lambda *now: told.append(now)), folder, told


def test_found_masks_show_what_moves_in_every_view(masked):
    found, folder, told = masked
    for t in range(FRAMES):
        for shot in found.frames[t]:
            assert shot.mask == folder / shot.camera.name / f"{t:06d}.png"
            shown, subject_there = read_mask(shot.mask, (SIZE, SIZE)) > 0, truth(shot.camera, t)
            assert iou(shown, subject_there) > 0.6 and (shown & subject_there).sum() > 0.95 * subject_there.sum()
    assert [now[1] for now in told] == list(range(1, 2 * 7 + FRAMES + 1))
    assert {now[::2] for now in told} == {("masks", 2 * 7 + FRAMES)}


def test_masks_that_are_there_are_kept_and_the_scenes_own_win(scene, masked, monkeypatch):
    _, folder, _ = masked
    mended = folder / "cam00" / "000001.png"
    before = mended.read_bytes()
    write_mask(mended, np.ones((SIZE, SIZE), np.bool_))
    own = scene.frames[2][3].source.path
    shots = [list(row) for row in scene.frames]
    shots[2][3] = replace(shots[2][3], mask=own)
    monkeypatch.setattr(data_foreground, "find_masks", None)
    again = with_found_masks(replace(scene, frames=tuple(map(tuple, shots))), folder)
    assert again.frames[2][3].mask == own
    assert read_mask(again.frames[1][0].mask, (SIZE, SIZE)).all()
    mended.write_bytes(before)


def test_one_missing_mask_is_found_and_others_stay_as_they_were_mended(scene, tmp_path, monkeypatch):
    empty = Masks(np.zeros((SIZE, SIZE), np.bool_) for _ in range(FRAMES))
    monkeypatch.setattr(data_foreground, "find_masks", lambda *_: Found([empty] * 7, 1.0))
    (tmp_path / "cam00").mkdir()
    write_mask(tmp_path / "cam00" / "000000.png", np.ones((SIZE, SIZE), np.bool_))
    found = with_found_masks(scene, tmp_path)
    assert read_mask(found.frames[0][0].mask, (SIZE, SIZE)).all()
    assert not read_mask(found.frames[0][1].mask, (SIZE, SIZE)).any()


def test_what_one_view_alone_shows_is_dropped(scene):
    """Something bright moves through the picture of one camera, on its lens."""
    shots = [list(row) for row in scene.frames]
    for t in range(FRAMES):
        shot = shots[t][0]
        picture = shot.source.read((SIZE, SIZE)).copy()
        picture[80:94, 10 * t : 10 * t + 16] = (250, 30, 200)
        path = shot.source.path.with_name(f"marked{t}.png")
        write_png(path, picture)
        shots[t][0] = replace(shot, source=replace(shot.source, path=path))
    found = find_masks(replace(scene, frames=tuple(map(tuple, shots))))
    assert all(not found.masks[0][t][80:94].any() for t in range(FRAMES))
    assert np.mean([iou(found.masks[0][t], truth(scene.cameras[0], t)) for t in range(FRAMES)]) > 0.6


def test_a_scene_where_nothing_moves_is_refused_and_leaves_no_folder(scene, tmp_path):
    still = replace(scene, frames=tuple(scene.frames[0] for _ in range(FRAMES)))
    with pytest.raises(SceneError, match="expected something that moves"):
        open_run(still, tmp_path / "m", AUTO)
    assert not (tmp_path / "m").exists()


def test_cameras_that_do_not_agree_are_refused_with_the_figure(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(data_foreground, "find_masks", lambda *_: Found([], 0.34))
    with pytest.raises(SceneError, match=r"agree on the foreground by 34 %, expected at least 50.*--foreground off"):
        with_found_masks(scene, tmp_path / "masks")
    assert not (tmp_path / "masks").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: replace(s, frames=s.frames[:4]), "at least 5 frames, got 4"),
        (lambda s: with_held_out(s, [f"cam{i:02d}" for i in range(5)]), "at least 3 training cameras, got 2"),
        (lambda s: replace(s, frames=(s.frames[0][::-1], *s.frames[1:])), "cameras that stand still"),
    ],
)
def test_what_masks_need_is_said(scene, change, message):
    with pytest.raises(SceneError, match=message):
        find_masks(change(scene))


def test_a_run_trains_the_subject_alone_and_goes_on_with_its_masks(scene, masked, tmp_path, monkeypatch):
    found, _, _ = masked
    masks = [[read_mask(shot.mask, (SIZE, SIZE)) > 0 for shot in row] for row in found.frames]
    one = Found([Masks(row[i] for row in masks) for i in range(7)], 1.0)
    monkeypatch.setattr(data_foreground, "find_masks", lambda *_: one)
    run = open_run(scene, tmp_path / "m", AUTO)
    view = run.capture.pictures.train(1)[0]
    assert (view.target.rgb[~masks[1][0]] == 0).all() and view.target.rgb[masks[1][0]].mean() > 0.2
    monkeypatch.setattr(data_foreground, "find_masks", None)
    again = open_run(scene, tmp_path / "m", AUTO, resume=True)
    assert (again.capture.pictures.train(1)[0].target.rgb == view.target.rgb).all()
    (tmp_path / "m" / "masks" / "cam00" / "000001.png").write_bytes(b"not a picture")
    with pytest.raises(SceneError, match="expected a picture"):
        open_run(scene, tmp_path / "m", AUTO, resume=True)
    assert (tmp_path / "m" / "masks").is_dir()
    run.model.discard()
    assert not (tmp_path / "m").exists()


def test_a_cut_follows_colours_and_keeps_what_is_sure():
    rng = np.random.default_rng(0)
    wall, red = rng.integers(95, 125, (48, 48, 3), np.uint8), np.array([220, 40, 40], np.uint8)
    picture, inside = wall.copy(), np.zeros((48, 48), np.bool_)
    inside[12:36, 12:36] = True
    picture[12:36, 12:24] = red + rng.integers(0, 20, (24, 12, 3), np.uint8)  # its right half looks like the wall
    near = np.zeros_like(inside)
    near[8:40, 8:40] = True
    colours = learn_colours(picture[near], picture[~near])
    assert np.diff(unlike_background(np.stack([wall[0, 0], red]), colours))[0] > 5
    assert (cut_out(picture, near, np.zeros_like(near), colours) == inside & (np.arange(48) < 24)).mean() > 0.99
    assert (cut_out(picture, near, inside, colours) == inside).mean() > 0.99
    assert learn_colours(picture[near][:20], picture[~near]) is None


def test_filled_masks_have_neither_holes_nor_small_parts():
    mask = np.zeros((40, 40), np.bool_)
    mask[5:20, 5:20] = True
    whole = mask.copy()
    mask[10:12, 10:12], mask[30:32, 30:32] = False, True
    assert (filled(mask, 10) == whole).all()


@pytest.mark.parametrize("fisheye", [False, True])
def test_masks_are_bent_as_the_lens_bends_pictures(fisheye):
    matrix = np.array([[90.0, 0, 48], [0, 90, 40], [0, 0, 1]])
    lens = fit_lens((96, 80), matrix, np.array([-0.2, 0.05, 0.0, 0.0]), fisheye)
    mask = np.zeros((80, 96), np.bool_)
    mask[10:60, 20:80] = True
    bent = distorted(mask, lens)
    assert (bent != mask).sum() > 30
    back = undistort(bent.astype(np.float32), lens) > 0.5
    assert iou(back, mask) > 0.97
