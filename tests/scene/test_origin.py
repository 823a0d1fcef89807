"""Positions far from zero: an origin comes off in float64, whatever file they are in, and what is lost is said."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.inspect.compare import compare
from airgs_codec.scene.camera import cameras_from
from airgs_codec.scene.formats.table import read
from airgs_codec.scene.frames import in_world
from airgs_codec.trainer.record import ModelFolder, TrainedFrame
from tests import faces
from tests.faces import GaussianSequence, SceneError, open_sequence, repair, write_ply
from tests.support.camera_files import write_colmap_text, write_nerfstudio
from tests.support.multiview_files import write_cameras
from tests.support.ply import Column, ply_bytes
from tests.support.scenes import moving_frames, random_gaussians
from tests.support.splat_files import glb_bytes

UTM = (448262.7, 5411932.2, 113.4)
NAMES = ["x", "y", "z", *(f"rot_{i}" for i in range(4)), *(f"scale_{i}" for i in range(3)), "opacity",
         *(f"f_dc_{i}" for i in range(3))]  # fmt: skip


def ascii_ply(g):
    table = np.hstack([g.means, g.quaternions, g.log_scales, g.opacity_logits[:, None], g.sh_dc])
    columns = [Column(n, "double" if n in "xyz" else "float", table[:, i]) for i, n in enumerate(NAMES)]
    return b"\xef\xbb\xbf" + ply_bytes({"vertex": columns}, newline="\r\n")


def opened(folder, form, frame, cameras):
    far = in_world(frame, UTM)
    if form == "memory":
        return GaussianSequence.from_arrays([far], cameras=cameras)
    write_cameras(folder / "transforms.json", cameras)
    if form == "ascii":
        (folder / "a.ply").write_bytes(ascii_ply(far))
    elif form == "node":
        (folder / "a.glb").write_bytes(glb_bytes(frame, translation=list(UTM)))
    else:
        write_ply(folder / "a.ply", frame if form == "told" else far)
        (folder / "sequence.json").write_text(json.dumps({"origin": UTM} if form == "told" else {}))
    return open_sequence(folder)


@pytest.mark.parametrize("form", ["doubles", "ascii", "node", "memory", "told"])
@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_nothing_is_lost_far_from_zero(tmp_path, form, scale):
    frame = random_gaussians(60).placed(np.zeros(3), scale)
    cameras = cameras_from(np.negative(UTM), faces.orbit_views(frame, count=3))
    sequence = opened(tmp_path, form, frame, cameras)
    back, origin, given = sequence.read(0), np.array(sequence.origin), frame.means + np.array(UTM)
    assert back.means.dtype == np.float32
    np.testing.assert_allclose(back.means + origin, given, atol=1e-7 * scale, rtol=0)
    for found, camera in zip(sequence.cameras, cameras, strict=True):
        np.testing.assert_allclose(found.position + origin, camera.position, atol=1e-8, rtol=0)
    assert any("448262" in note and "100%" in note for note in sequence.notes) == (form != "told")


def test_what_float32_cannot_hold_is_refused_or_said(tmp_path):
    """Files that lost it already; parts that no one origin suits, too far from each other."""
    near, path = random_gaussians(40), tmp_path / "a.ply"
    write_ply(path, replace(near, means=in_world(near, UTM).means.astype(np.float32)))
    [note] = open_sequence(tmp_path).notes
    assert "in the files has moved 100% of what is opaque" in note
    parts = [in_world(random_gaussians(20, seed=i), [i * 1e8, 0, 0]) for i in range(3)]
    write_ply(path, faces.join_rows(parts))
    with pytest.raises(SceneError, match=r"a\.ply: .* float32 moves 6\d%"):
        open_sequence(tmp_path).read(0)
    with pytest.raises(SceneError, match="open_sequence"):
        write_ply(path, parts[1])
        read(path)
    some = replace(near, means=np.where(np.arange(40)[:, None] < 4, near.means + np.float32(1e5), near.means))
    assert any("float32 moves" in note for note in repair([some], "a").notes) and not repair([near], "a").notes


def test_repairs_are_weighed_and_most_of_a_scene_is_not_hidden():
    g = random_gaussians(40)
    g = replace(g, opacity_logits=np.zeros(40, np.float32), means=g.means.copy())
    g.means[:10] = np.inf
    assert "25.00% of what is opaque" in repair([g], "a").notes[0]
    g.means[:21] = np.nan
    with pytest.raises(SceneError, match="52% of what is opaque in frame 1"):
        repair([random_gaussians(40), g], "a")


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A scene of two frames far from zero, and the package of it."""
    scene, out = tmp_path_factory.mktemp("far"), tmp_path_factory.mktemp("package") / "far.airgs"
    frames = moving_frames(80, 2)
    for number, frame in enumerate(frames):
        write_ply(scene / f"{number}.ply", in_world(frame, UTM))
    cameras = faces.orbit_views(frames[0], count=4, size=64)
    write_cameras(scene / "transforms.json", cameras_from(np.negative(UTM), cameras))
    faces.encode(scene, out, faces.EncodeSettings(calibrate="none", measure_pictures=0))
    return scene, out


def test_rows_know_which_they_were(package, tmp_path):
    """Of a package whose rows were sorted and left out, frame by frame; rows that are twice are none."""
    (scene, out), folder = package, tmp_path / "back"
    faces.airgs_decode(f"{out} -o {folder} --frames 1 --level L1 --against {scene}".split())
    with np.load(folder / "rows.npz") as file:
        rows = file["1"]
    back, given, found = open_sequence(folder), open_sequence(scene), rows >= 0
    assert len(rows) == back.count(0) and found.mean() > 0.95 and len(set(rows[found])) == found.sum()
    away = np.abs(back.read(0).means - given.at_origin(back.origin).read(1).means[rows])[found]
    assert np.median(away) < 0.01 and not np.array_equal(rows, np.sort(rows))


def test_a_package_far_from_zero_says_so_and_what_is_decoded_is_where_it_was(package, tmp_path, capsys):
    scene, out = package
    assert faces.airgs_manifest(["validate", str(out), "--against", str(scene)]) == 0
    assert faces.airgs_manifest(["inspect", str(out)]) == 0
    assert "origin: positions are from (448262" in capsys.readouterr().out
    for form in ("ply", "splat"):
        faces.airgs_decode([str(out), "-o", str(tmp_path / form), "--format", form])
        assert ("sequence.json says it" in capsys.readouterr().out) == (form == "splat")
        back = open_sequence(tmp_path / form)
        assert compare(scene, back).quality.psnr > 30 and compare(back, out).quality.psnr > 45
        box = [np.median(s.read(1).means + np.array(s.origin), axis=0) for s in (open_sequence(scene), back)]
        np.testing.assert_allclose(box[1], box[0], atol=0.2, rtol=0)


@pytest.mark.parametrize("write", [write_colmap_text, write_nerfstudio])
def test_trainers_begin_there_and_files_are_in_the_world(tmp_path, write):
    cloud = random_gaussians(50)
    cameras = faces.orbit_views(cloud, count=4)
    for name, shift in (("near", (0, 0, 0)), ("far", UTM)):
        model = write(tmp_path / name, cameras_from(np.negative(shift), cameras))
        if model.is_dir():
            rows = [f"{i} {x!r} {y!r} {z!r} 9 9 9 0" for i, (x, y, z) in enumerate((cloud.means + shift).tolist())]
            (model / "points3D.txt").write_text("\ufeff" + "\r\n".join(rows), encoding="utf-8")
    near, far = (faces.open_scene(tmp_path / name) for name in ("near", "far"))
    assert near.origin == (0, 0, 0) and abs(far.origin[0] - UTM[0]) < 4
    away = np.array(far.origin) - UTM
    for a, b in zip(near.cameras, far.cameras, strict=True):
        np.testing.assert_allclose(b.position + away, a.position, atol=1e-7)
        assert b.near == pytest.approx(a.near, rel=1e-5)
    if far.points:
        assert far.points.positions.dtype == np.float32
        np.testing.assert_allclose(far.points.positions + away, cloud.means, atol=1e-6)
    model = ModelFolder(tmp_path, faces.Record.of(far, (0, 0, 0), faces.TrainSettings()))
    model.write_cameras(far.cameras)
    model.commit(TrainedFrame(cloud, faces.FrameRecord(0, "first", 50, 0, 30.0, None, None, None, None, 1.0)))
    np.testing.assert_allclose(model.read(0).means, cloud.means, atol=1e-7)
    np.testing.assert_allclose(faces.read_ply(tmp_path / "000000.ply").means - far.origin, cloud.means, atol=1e-7)
    np.testing.assert_allclose(open_sequence(tmp_path).cameras[0].position, far.cameras[0].position, atol=4)
