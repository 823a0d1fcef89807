"""Frames and point clouds: every form of .ply that holds them, and one line for what does not."""

import numpy as np
import pytest

from airgs_codec.scene.formats.ply import read_ply_header, read_points
from tests.faces import SceneError, read_ply, write_ply
from tests.support.ply import ORDERS, Column, ply_bytes
from tests.support.scenes import random_gaussians

PROPERTIES = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
PROPERTIES += [f"rot_{i}" for i in range(4)]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_was_written_is_read_back_exactly(tmp_path, degree):
    g = random_gaussians(37, degree)
    write_ply(tmp_path / "a.ply", g)
    back = read_ply(tmp_path / "a.ply")
    for name in g.__slots__:
        np.testing.assert_array_equal(getattr(back, name), getattr(g, name))
    assert (read_ply_header(tmp_path / "a.ply").count, back.sh_degree) == (37, degree)


def ascii_ply(names, rows):
    return ply_bytes({"vertex": [Column(n, "float", [row[i] for row in rows]) for i, n in enumerate(names)]}).decode()


def test_ascii_in_any_property_order(tmp_path):
    names = PROPERTIES[::-1]
    (tmp_path / "a.ply").write_text(ascii_ply(names, [list(range(len(names)))]))
    g = read_ply(tmp_path / "a.ply")
    value = {n: float(i) for i, n in enumerate(names)}
    assert g.means.tolist() == [[value["x"], value["y"], value["z"]]]
    assert g.quaternions.tolist() == [[value[f"rot_{i}"] for i in range(4)]]
    assert g.opacity_logits.tolist() == [value["opacity"]]


def test_f_rest_is_channel_major_in_the_file(tmp_path):
    names = PROPERTIES + [f"f_rest_{i}" for i in range(9)]
    (tmp_path / "a.ply").write_text(ascii_ply(names, [[0] * len(PROPERTIES) + list(range(9))]))
    assert read_ply(tmp_path / "a.ply").sh_rest[0].tolist() == [[0, 3, 6], [1, 4, 7], [2, 5, 8]]


def test_the_bytes_of_a_frame_are_pinned(tmp_path):
    """INRIA's properties in INRIA's order, as every viewer expects them."""
    write_ply(tmp_path / "a.ply", random_gaussians(2, 1))
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    names = [line.split()[2] for line in header.decode().splitlines() if line.startswith("property float ")]
    rest = [f"f_rest_{i}" for i in range(9)]
    assert names == ["x", "y", "z", "nx", "ny", "nz", *PROPERTIES[3:6], *rest, *PROPERTIES[6:]]
    assert header.decode().splitlines()[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 2"]
    assert len(body) == 2 * 4 * len(names)


@pytest.mark.parametrize(("kind", "scale"), [("uchar", 255), ("ushort", 65535), ("float", 1), ("double", 1)])
@pytest.mark.parametrize("form", ORDERS)
def test_points_have_colours_of_0_to_1(tmp_path, form, kind, scale):
    share = np.array([[0, 0.2, 1], [1, 0.6, 0.4]])
    values = np.round(share * scale) if scale > 1 else share
    vertex = [Column(n, "double", [i, -i]) for i, n in enumerate("xyz")]
    vertex += [Column(n, kind, values[:, i]) for i, n in enumerate(("red", "green", "blue"))]
    (tmp_path / "a.ply").write_bytes(ply_bytes({"vertex": vertex}, form))
    positions, colours = read_points(tmp_path / "a.ply")
    assert positions.tolist() == [[0, 1, 2], [0, -1, -2]]
    np.testing.assert_allclose(colours, share, atol=1e-7)
    (tmp_path / "b.ply").write_bytes(ply_bytes({"vertex": vertex[:3]}, form))
    assert read_points(tmp_path / "b.ply")[1] is None


@pytest.mark.parametrize("elements", [{"vertex": [Column("x", "float", [0])]}, {"face": [Column("x", "float", [0])]}])
def test_what_is_no_point_cloud_is_refused(tmp_path, elements):
    (tmp_path / "a.ply").write_bytes(ply_bytes(elements))
    with pytest.raises(SceneError, match=r"a\.ply: expected"):
        read_points(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "expected a .ply header"),
        (b"not a ply at all\n", "expected a .ply header"),
        (ascii_ply(["x", "y", "z"], [[0, 0, 0]]).encode(), "missing f_dc_0"),
        (ascii_ply([*PROPERTIES, "f_rest_0"], [[0] * 15]).encode(), "expected 0, 9, 24 or 45 f_rest"),
        (ascii_ply([*PROPERTIES, *(f"f_rest_{i}" for i in range(1, 10))], [[0] * 23]).encode(), "missing f_rest_0"),
        (ascii_ply([*PROPERTIES, "log_duration"], [[0] * 15]).encode(), "got those of FTGS, which move"),
        (ascii_ply(PROPERTIES, [[0] * 14]).replace("vertex 1", "vertex 9").encode(), "truncated"),
    ],
)
def test_a_broken_file_is_refused_in_one_line(tmp_path, content, says):
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(SceneError, match=says) as caught:
        read_ply(tmp_path / "bad.ply")
    assert "bad.ply" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(SceneError, match="cannot read"):
        read_ply(tmp_path / "none.ply")
