"""Cameras of every form: one rig is the same from each, what is no cameras is refused, what lies beside is found."""

import json
import struct
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest

from airgs_codec.scene.cameras import colmap
from tests.faces import SceneError, find_cameras, read_cameras, read_posed
from tests.support import camera_files as files
from tests.support.camera_files import FORMS, as_inria, intrinsics_of, saved
from tests.support.clip_files import random_rows, splatv_bytes
from tests.support.multiview_files import matrix_of
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence
from tests.support.views import ring

NEAR = {"inria": 0.2, "splatv": 0.2, "panoptic": 0.8}  # planes that a form implies
CENTRES = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # of pixels, which OpenCV counts from
POINTS = np.array([[0.2, -0.1, 1.0], [-0.3, 0.25, 1.5], [0.0, 0.0, 2.0]])
COEFFICIENTS = (0.05, -0.01, 0.004, 0.002, 0.01, 0.02, -0.01, 0.003)


def assert_same(back, rig):
    assert len(back) == len(rig)
    for a, b in zip(back, rig, strict=True):
        assert (a.width, a.height) == (b.width, b.height)
        np.testing.assert_allclose(a.position, b.position, atol=1e-6)
        np.testing.assert_allclose(a.world_to_camera[:3, :3], b.world_to_camera[:3, :3], atol=1e-6)
        np.testing.assert_allclose([a.fx, a.fy, a.cx, a.cy], [b.fx, b.fy, b.cx, b.cy], atol=1e-6)


@pytest.fixture(scope="module", params=["fox", "wide"])
def rig(request):
    """20 cameras of the embedded scene, 4 held out; and three whose pictures are wider than high."""
    if request.param == "fox":
        return read_cameras(FOX / "transforms.json")
    return [replace(c, width=2 * c.width, cx=c.width) for c in ring(3)]


@pytest.mark.parametrize("form", FORMS)
def test_one_rig_is_the_same_from_every_form(tmp_path, rig, form):
    path = FORMS[form](tmp_path, rig)
    in_order = sorted(rig, key=lambda c: c.held_out) if form == "panoptic" else rig
    parts = [path / name for name in ("images.txt", "cameras.txt")] if form == "colmap text" else []
    folders = [] if form == "splatv" else [tmp_path]
    for given in (path, *folders, *parts):  # the file or COLMAP's model, a folder with it, a file that stands for all
        back = read_cameras(given)
        assert_same(back, in_order)
        held_out = [c.held_out for c in in_order] if form in files.MARK_HELD_OUT else [False] * len(rig)
        assert [c.held_out for c in back] == held_out and {c.near for c in back} == {NEAR.get(form, 0)}


@pytest.mark.parametrize("form", [form for form in FORMS if "colmap" not in form])
def test_a_file_is_known_by_what_it_holds(tmp_path, form):
    path = FORMS[form](tmp_path / "a" if form != "llff" else tmp_path, ring(3))
    mark = b"" if form in ("llff", "splatv") else b"\xef\xbb\xbf"  # before a text, of which it is no part
    other = saved(tmp_path / "b" / ("rig.txt" if mark else "some.json"), mark + path.read_bytes())
    assert_same(read_cameras(other), ring(3))


@pytest.mark.parametrize("form", FORMS)
def test_files_that_windows_wrote_are_read_alike(tmp_path, form):
    """With a byte-order mark, lines that end in CR LF, and backslashes in paths."""
    for name in "ab":
        (tmp_path / name).mkdir()
    there, place = (FORMS[form](tmp_path / name, ring(4, held_out=1)) for name in "ab")
    for path in place.parent.rglob("*"):
        if path.suffix in (".json", ".txt"):
            text = path.read_text().replace("images/", "images\\\\").replace("\n", "\r\n")
            path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    for a, b in zip(read_posed(there), read_posed(place), strict=True):
        assert (a.picture, a.camera.name, a.camera.split) == (b.picture, b.camera.name, b.camera.split)
        np.testing.assert_array_equal(a.camera.world_to_camera, b.camera.world_to_camera)


def entries_of(cameras, **fields):
    return [{"transform_matrix": matrix_of(c), **intrinsics_of(c), **fields} for c in cameras]


def read_entries(folder, entries, **shared):
    return read_cameras(saved(folder / "transforms.json", {**shared, "frames": entries}))


def transforms(**fields):
    return lambda folder: saved(folder / "t.json", {"frames": entries_of(ring(1), **fields)})


def llff(old, new):
    return lambda folder: saved(path := files.write_llff(folder, ring(3)), path.read_bytes().replace(old, new))


def colmap_model(line):
    images = {"images.txt": b"1 1 0 0 0 0 0 4 1 a.png\n\n", "cameras.txt": f"{line}\n".encode()}
    return lambda folder: [saved(folder / name, data) for name, data in images.items()] and folder


def panoptic_without_pictures(folder):
    data = json.loads(files.write_panoptic_meta(folder, ring(2)).read_text())
    return saved(folder / "train_meta.json", data | {key: [data[key][0], []] for key in ("fn", "k", "w2c", "cam_id")})


NOTHING = ("{}", "[]", "[1]", '{"frames": 3}', '{"k": [], "w2c": [], "cam_id": []}', "{", "")
NO_CAMERA = [
    {"w": 0}, {"near": 0}, {"near": float("inf")}, {"transform_matrix": [[1]]}, {"fl_x": None},
    {"transform_matrix": np.zeros((4, 4)).tolist()}, {"transform_matrix": np.full((4, 4), np.nan).tolist()},
]  # fmt: skip
NO_LENS = [{"camera_model": "EQUIRECTANGULAR"}, {"k1": float("nan")}, {"k1": 0.1, "w": 10**20}]

NO_SCENE = [as_inria(ring(1))[0] | {"position": files.PLACEHOLDER}]
REFUSED = [
    *((lambda folder, text=text: saved(folder / "cameras.json", text.encode()).parent, r"cameras\.json: expected")
      for text in NOTHING),
    *((transforms(**fields), r"t\.json: expected a nerfstudio") for fields in NO_CAMERA),
    *((transforms(**fields), r"json: expected a nerfstudio transforms\.json: camera") for fields in NO_LENS),
    (lambda folder: folder / "none", r"none: expected cameras .* No such file"),
    (lambda folder: folder, "got none of them"),
    (lambda folder: saved(folder / "text.md", b"# words"), r"text\.md: expected cameras"),
    (llff(b"}", b"("), r"poses_bounds\.npy: expected rows of 17 numbers: its header is broken"),
    (llff(b"(3, 17), }" + b" " * 12, b"(3" + b"0" * 12 + b", 17), }"),
     r"poses_bounds\.npy: expected rows of 17 numbers: Unable to allocate"),
    (panoptic_without_pictures, "a frame has no pictures"),
    *((lambda folder, data=data: saved(folder / "cameras.json", data), "expected cameras")  # at the cost of its bytes
      for data in (b"[" * 500_000, b"[" + b"1" * 500_000 + b"]")),
    (lambda folder: saved(folder / "a.splatv", struct.pack("<II", 0x674B, 500_000) + b"[" * 500_000),
     "expected a .splatv header"),
    (lambda folder: [saved(folder / f"{name}.bin", b"\xff" * 8) for name in ("cameras", "images")][1],
     "cameras.bin: expected a COLMAP reconstruction"),  # of 2^64 - 1 cameras
    (lambda folder: saved(folder / "a.splatv", splatv_bytes(random_rows(1), cameras=NO_SCENE)),
     "the one that splaTV writes into every file"),
    *((colmap_model(line), rf"txt: expected a COLMAP reconstruction: .*{says}") for line, says in (
        ("1 FOV 32 24 60 62 16 12 0.1", "perspective or fisheye camera model, got FOV"),
        ("1 PINHOLE 32 24 60", "a camera model and its parameters, got PINHOLE with 1"),
        ("2 PINHOLE 32 24 60 62 16 12", "no 1"),  # the image's camera is not there
        ("1 PINHOLE wide 24 60 62 16 12", "invalid literal"))),
]  # fmt: skip


@pytest.mark.parametrize(("make", "says"), REFUSED)
def test_what_is_no_cameras_is_refused_in_one_line(tmp_path, make, says):
    with pytest.raises(SceneError, match=says) as caught:
        read_cameras(make(tmp_path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("form", FORMS)
def test_every_file_cut_short_is_refused_in_one_line(tmp_path, form):
    path = FORMS[form](tmp_path, ring(3))
    broken = 0
    for file in [path] if path.is_file() else sorted(path.glob("[ci]*.*")):
        whole = file.read_bytes()
        for length in {0, 7, 12, 40, len(whole) // 2, int(len(whole) * 0.9)}:
            file.write_bytes(whole[:length])
            try:
                assert len(read_cameras(path)) <= 3  # a text may end after a whole line
            except SceneError as error:
                assert "expected" in str(error) and "\n" not in str(error)
                broken += 1
        file.write_bytes(whole)
    assert broken >= 4


STRETCHED, MIRRORED = np.diag([1.0, 2.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0, 1.0])
BY_QUATERNION = ("colmap text", "colmap binary")  # of any norm
WRONG = [
    ({"fx": float("nan"), "fy": float("nan")}, "not finite", ()),
    ({"fx": -5.0, "fy": -5.0}, "above 0", ()),
    ({"width": 10**6}, "pixels", ("inria", "splatv")),  # which show wide pictures at another width
    ({"world_to_camera": STRETCHED}, "rotation", BY_QUATERNION),
    ({"world_to_camera": MIRRORED}, "rotation", BY_QUATERNION),
]


@pytest.mark.parametrize(
    ("form", "fields", "says"),
    [(form, fields, says) for fields, says, but in WRONG for form in FORMS if form not in (*but, "nerfstudio")],
)
def test_a_camera_that_is_none_is_refused_in_every_form(tmp_path, form, fields, says):
    first, *others = ring(3)
    path = FORMS[form](tmp_path, [replace(first, **fields), *others])
    with pytest.raises(SceneError, match=says) as caught:
        read_cameras(path)
    assert str(path.parent) in str(caught.value)


def test_a_lens_leaves_the_pinhole_camera_of_undistorted_pictures(tmp_path):
    bending = {}, {"k1": 0.1, "k2": 0.01, "camera_model": "OPENCV"}, {"camera_model": "OPENCV_FISHEYE"}
    plain, bent, fisheye = (read_entries(tmp_path, entries_of(ring(1), **fields))[0] for fields in bending)
    assert plain.fx == ring(1)[0].fx and abs(bent.fx - plain.fx) > 0.5 and abs(fisheye.fx - plain.fx) > 0.5
    np.testing.assert_array_equal(bent.world_to_camera, plain.world_to_camera)


def test_entries_count_once_for_each_camera_and_what_they_share_may_stand_beside_them(tmp_path):
    """A rig that stands still is seen once, a camera that moves as often as it moved; names are those of pictures."""
    first, second = entries_of(ring(2))
    over_time = [
        {**e, "time": t, "file_path": f"cam{i}/{t}.png"} for t in range(3) for i, e in enumerate((first, second))
    ]
    moving = [{**e, "time": t, "file_path": f"images/r_{t}"} for t, e in enumerate(entries_of(ring(5)))]
    for entries, names in (
        (over_time, ["cam0", "cam1"]),
        (moving, ["r_0", "r_1", "r_2", "r_3", "r_4"]),
        ([first, second], ["view000", "view001"]),
    ):
        assert [c.name for c in read_entries(tmp_path, entries)] == names
    shared, poses = intrinsics_of(ring(1)[0]) | {"near": 0.3}, [{"transform_matrix": matrix_of(c)} for c in ring(3)]
    assert [(c.fx, c.near) for c in read_entries(tmp_path, poses, **shared)] == [(ring(1)[0].fx, 0.3)] * 3
    trembling = [first | {"camera": "a", "time_index": 0}, second | {"camera": "a", "time_index": 1}]
    np.testing.assert_allclose([c.position for c in read_entries(tmp_path, trembling)], [ring(2)[0].position])


def test_panoptic_has_one_camera_for_each_number_and_those_of_its_test_file_are_held_out(tmp_path):
    path = files.write_panoptic_meta(tmp_path, ring(9, held_out=2))
    assert [c.name for c in read_cameras(path)] == [f"cam{i:02d}" for i in range(9)]
    held_out = read_cameras(path.with_name("test_meta.json"))
    assert [(c.name, c.held_out) for c in held_out] == [("cam07", True), ("cam08", True)]


def test_wide_pictures_of_inria_are_shown_as_it_shows_them(tmp_path):
    """Its file has their full size, its models were trained and are looked at in at most 1,600 pixels' width."""
    wide = replace(ring(1)[0], width=4946, height=3286, fx=4600.0, fy=4610.0)
    back = read_cameras(saved(tmp_path / "cameras.json", as_inria([wide])))[0]
    assert (back.width, back.height, back.cx, back.cy) == (1600, 1063, 800, 531.5)
    assert back.fx / back.width == pytest.approx(wide.fx / wide.width)  # the same field of view
    assert back.fy / back.height == pytest.approx(wide.fy / wide.height)


def test_every_model_has_the_number_and_parameters_that_colmap_gives_it():
    for number, model in enumerate(colmap.MODELS):
        theirs = pycolmap.Camera(model=model.name, width=32, height=24)
        assert (int(theirs.model), len(theirs.params_info.split(","))) == (number, model.parameters)


@pytest.mark.parametrize("model", [model for model in colmap.MODELS if model.focals], ids=lambda model: model.name)
@pytest.mark.parametrize("binary", [False, True])
def test_lenses_bend_as_colmap_bends(tmp_path, model, binary):
    values = [*(60.0, 62.0)[: model.focals], 16.5, 12.5, *COEFFICIENTS]
    theirs = pycolmap.Camera(model=model.name, width=32, height=24, params=values[: model.parameters], camera_id=1)
    (tmp_path / "cameras.txt").write_text(f"1 {model.name} 32 24 {' '.join(map(str, theirs.params))}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 4 1 a b.png\n1 1 -1\n")
    (tmp_path / "points3D.txt").touch()
    if binary:
        pycolmap.Reconstruction(str(tmp_path)).write_binary(str(tmp_path))
        for file in tmp_path.glob("*.txt"):
            file.unlink()
    (posed,) = read_posed(tmp_path)
    assert posed.camera.name == ("a" if binary else "a b")  # COLMAP ends a name at a space
    if (lens := posed.lens) is None:
        c = posed.camera
        ours = POINTS[:, :2] / POINTS[:, 2:] * [c.fx, c.fy] + [c.cx, c.cy]
    else:  # in the picture as it was taken
        bend = cv2.fisheye.projectPoints if lens.fisheye else cv2.projectPoints
        still = np.zeros(3)
        ours = bend(POINTS[:, None], still, still, lens.matrix - CENTRES, lens.coefficients)[0][:, 0] + 0.5
    np.testing.assert_allclose(ours, [theirs.img_from_cam(point) for point in POINTS], atol=1e-4)


@pytest.mark.parametrize(("form", "points"), [("colmap text", b""), ("colmap binary", bytes(8))])
def test_what_the_tests_write_is_what_colmap_reads(tmp_path, form, points):
    model = FORMS[form](tmp_path, ring(3))
    (model / ("points3D.bin" if points else "points3D.txt")).write_bytes(points)
    theirs = sorted(pycolmap.Reconstruction(str(model)).images.values(), key=lambda image: image.name)
    for image, posed in zip(theirs, read_posed(model), strict=True):
        np.testing.assert_allclose(image.cam_from_world().matrix(), posed.camera.world_to_camera[:3], atol=1e-12)


@pytest.mark.parametrize(("frames", "cameras"), [
    ("scene", "scene"),
    ("model/point_cloud/iteration_30000", "model"),  # as INRIA's code leaves its models
    ("model/gaussian_pertimestamp", "model"),  # as 4DGaussians adds frames to one
    ("many/scene", None),  # of another scene
])  # fmt: skip
def test_cameras_beside_a_scene_are_found(tmp_path, frames, cameras):
    scene = write_sequence(tmp_path / frames, moving_frames(4, 1), cameras=False)
    (tmp_path / "model" / "point_cloud").mkdir(parents=True, exist_ok=True)
    saved(scene / "notes.json", as_inria(ring(2)))
    assert find_cameras(scene) is None
    path = files.write_inria(tmp_path / (cameras or "many"), ring(3))
    found = find_cameras(scene)
    assert found is None if cameras is None else found.resolve() == path.resolve()


def test_the_first_form_beside_a_scene_is_taken(tmp_path):
    for write in (files.write_colmap_text, files.write_inria, files.write_transforms):
        path = write(tmp_path, ring(3))
        assert find_cameras(tmp_path) == path
