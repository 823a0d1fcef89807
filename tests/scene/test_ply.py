import numpy as np
import pytest

from airgs_codec.errors import SceneError
from airgs_codec.scene.ply import read_ply, read_ply_header, write_ply
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
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(rows)}",
        *(f"property float {n}" for n in names),
        "end_header",
    ]
    return "\n".join(head + [" ".join(map(str, row)) for row in rows]) + "\n"


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


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "expected a .ply header"),
        (b"not a ply at all\n", "expected a .ply header"),
        (ascii_ply(["x", "y", "z"], [[0, 0, 0]]).encode(), "missing f_dc_0"),
        (ascii_ply([*PROPERTIES, "f_rest_0"], [[0] * 15]).encode(), "expected 0, 9, 24 or 45 f_rest"),
        (ascii_ply(PROPERTIES, [[0] * 14]).replace("vertex 1", "vertex 9").encode(), "truncated"),
    ],
)
def test_a_broken_file_is_refused_in_one_line(tmp_path, content, says):
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(SceneError, match=says) as caught:
        read_ply(tmp_path / "bad.ply")
    assert "bad.ply" in str(caught.value) and "\n" not in str(caught.value)


def test_a_truncated_binary_file_is_refused(tmp_path):
    write_ply(tmp_path / "a.ply", random_gaussians(50))
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data[:-100])
    with pytest.raises(SceneError, match="truncated"):
        read_ply(tmp_path / "a.ply")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(SceneError, match="cannot read"):
        read_ply(tmp_path / "none.ply")
