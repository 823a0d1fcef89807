"""Opening scenes: the format is recognised, frames are cut out, what is broken is refused."""

import json

import pytest

from airgs_codec.errors import SceneError
from airgs_codec.media.image import write_png
from airgs_codec.train.data.pictures import Pictures
from airgs_codec.train.data.readers import is_multiview, open_scene
from tests.support.camera_files import write_llff
from tests.support.multiview_files import plain, write_views
from tests.support.paths import FOX, FOX_VIEWS
from tests.support.views import coloured_cloud, ring


def test_frames_are_cut_out_and_points_stay_with_the_first(moving):
    assert len(open_scene(moving, frames=(1, None))) == 1
    assert open_scene(moving, frames=(1, None)).points is None
    with pytest.raises(SceneError, match="frames inside 0:2, got 1:5"):
        open_scene(moving, frames=(1, 5))


def test_what_is_multiview_and_what_is_a_sequence(tmp_path, moving):
    assert is_multiview(FOX_VIEWS) and is_multiview(moving)
    assert not is_multiview(FOX)  # .ply frames beside its transforms.json
    assert not is_multiview(tmp_path)


def broken(tmp_path, what):
    folder = tmp_path / "broken"
    g = coloured_cloud(30)
    if what == "nothing":
        folder.mkdir()
    elif what == "poses":
        folder.mkdir()
        write_llff(folder, ring(2))
    elif what == "colmap":
        (folder / "sparse" / "0").mkdir(parents=True)
        (folder / "sparse" / "0" / "images.bin").write_bytes(b"12")
    else:
        write_views(folder, [g], ring(3), None)
        path = folder / "transforms.json"
        data = json.loads(path.read_text())
        if what == "json":
            path.write_text("{")
        elif what == "no frames":
            path.write_text(json.dumps({**data, "frames": []}))
        elif what == "matrix":
            data["frames"][0]["transform_matrix"] = [[1, 2]]
            path.write_text(json.dumps(data))
        elif what == "missing picture":
            (folder / "images" / "cam01" / "0000.png").unlink()
        elif what == "size":
            write_png(folder / "images" / "cam01" / "0000.png", plain(3))
        elif what == "text":
            (folder / "images" / "cam01" / "0000.png").write_text("no picture")
        elif what == "points":
            (folder / "points3d.npy").write_bytes(b"x")
    return folder


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (
            "nothing",
            "pictures with train_meta.json, transforms.json, image_white_undistortion/ .HiFi4G., COLMAP.s sparse/, ",
        ),
        ("poses", "a row for each of 0 videos, got 2"),
        ("colmap", "expected a COLMAP reconstruction"),
        ("json", "expected JSON"),
        ("no frames", "at least one picture"),
        ("matrix", "expected a nerfstudio transforms.json"),
        ("missing picture", "0000.png: expected a picture, got nothing"),
        ("size", "expected a picture of 48x48, got 32x24"),
        ("text", "expected a picture, got something else"),
        ("points", "expected rows of x, y, z"),
    ],
)
def test_broken_scenes_are_refused_in_one_line(tmp_path, what, message):
    with pytest.raises(SceneError, match=message) as caught:
        Pictures(open_scene(broken(tmp_path, what))).check(0)
    assert "\n" not in str(caught.value)
