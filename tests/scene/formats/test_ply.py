"""PLY: one table in every form and order reads the same, frames and points of it, and one line for what is neither."""

import itertools
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.scene.formats.ply import read_columns, read_header
from tests.faces import SceneError, read_frame_header, read_ply, read_points, write_ply
from tests.support.camera_files import saved
from tests.support.ply import ORDERS, TYPES, Column, ply_bytes
from tests.support.scenes import random_gaussians

PROPERTIES = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
PROPERTIES += [f"rot_{i}" for i in range(4)]
MESH = {
    "before": [Column("corners", "int", [1, 2])],
    "vertex": [Column("x", "float", [1.5, 2.5]), Column("n", "uchar", [7, 8])],
}

NUMBERS = {
    name: st.floats(width=8 * int(kind[1]), allow_nan=True, allow_infinity=True) if kind[0] == "f"
    else st.integers(int(np.iinfo(kind).min), int(np.iinfo(kind).max))
    for name, kind in TYPES.items()
}  # fmt: skip


@st.composite
def columns(draw, rows, names):
    kinds = draw(st.lists(st.sampled_from(sorted(TYPES)), min_size=len(names), max_size=len(names)))
    values = [draw(st.lists(NUMBERS[kind], min_size=rows, max_size=rows)) for kind in kinds]
    return [Column(*column) for column in zip(names, kinds, values, strict=True)]


@st.composite
def neighbours(draw, with_lists):
    rows = draw(st.integers(0, 4))
    out = draw(columns(rows, draw(st.permutations(["red", "x"]))))
    if with_lists and draw(st.booleans()):
        lists = draw(st.lists(st.lists(st.integers(0, 255), max_size=5), min_size=rows, max_size=rows))
        column = Column("vertex_indices", "int", lists, draw(st.sampled_from(["uchar", "int"])))
        out.insert(draw(st.integers(0, 2)), column)
    return out


def table_of(path, names):
    header = read_header(path)
    return read_columns(path, header, header.elements["vertex"], [names])[0]


COMMENTS = st.sampled_from(["comment", "comment end_header", "obj_info property float x"])


@given(st.data())
@settings(max_examples=150)
def test_ascii_little_and_big_endian_give_the_same_table(tmp_path_factory, data):
    """Whatever stands before and after, in any order of properties and types, with comments and CR LF."""
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    vertex = data.draw(columns(data.draw(st.integers(0, 6)), data.draw(st.permutations(["x", "y", "z", "w"]))))
    before, after = (data.draw(neighbours(late)) if data.draw(st.booleans()) else None for late in (False, True))
    elements = {n: c for n, c in (("before", before), ("vertex", vertex), ("face", after)) if c is not None}
    comments = data.draw(st.lists(COMMENTS, max_size=3))
    wanted = np.array([np.array(c.values, np.result_type("f4", *(TYPES[c.type] for c in vertex))) for c in vertex]).T
    for form, newline in itertools.product(ORDERS, ("\n", "\r\n")):
        path.write_bytes(ply_bytes(elements, form, newline, comments))
        np.testing.assert_array_equal(table_of(path, [c.name for c in vertex]), wanted.reshape(-1, 4))


@pytest.mark.parametrize("form", ORDERS)
def test_more_rows_than_a_block_are_all_read(tmp_path, form):
    values = np.random.default_rng(0).normal(size=2 * 16384 + 5).astype("f4")
    elements = {"before": [Column("i", "int", range(3))], "vertex": [Column("x", "float", values)]}
    path = saved(tmp_path / "a.ply", ply_bytes(elements, form))
    np.testing.assert_array_equal(table_of(path, ["x"])[:, 0], values)


@pytest.mark.parametrize("form", ORDERS)
def test_a_file_cut_anywhere_is_refused_and_absurd_counts_are_before_memory_is_taken(tmp_path, form):
    path, whole = tmp_path / "a.ply", ply_bytes(MESH, form)
    cut = 1 if form != "ascii" else 3  # a line may lack its end, and 8 its newline
    for end in range(len(whole) - cut + 1):
        with pytest.raises(SceneError) as caught:
            table_of(saved(path, whole[:end]), ["x", "n"])
        assert "\n" not in str(caught.value) and "a.ply" in str(caught.value)
    for element, count in itertools.product(("before", "vertex"), (10**6, 10**17)):
        saved(path, whole.replace(f"element {element} 2".encode(), f"element {element} {count}".encode()))
        tracemalloc.start()
        with pytest.raises(SceneError, match="truncated"):
            table_of(path, ["x"])
        assert tracemalloc.get_traced_memory()[1] < 3e6
        tracemalloc.stop()


ILL_FORMED = [
    ("ply\n", "ply"), ("format ascii 1.0", "format ascii 2.0"), ("format ascii 1.0", "comment"),
    ("element vertex 2", "element vertex -2"), ("element vertex 2", "element vertex two"),
    ("element vertex 2", f"element vertex {'9' * 5000}"), ("float x", "real x"), ("float x", "float"),
    ("int corners", "list float int corners"),
    ("uchar n", "uchar x"), ("element before", "element vertex"), ("end_header", "end"),
    ("element vertex 2", "element vertex 2\nproperty list uchar int more"),
    ("1.5", "one"), ("1.5 7", "1.5"), ("1.5 7", "1.5 300"), ("1.5 7", "1.5 7.5"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new"), ILL_FORMED)
def test_what_is_not_well_formed_is_refused_in_one_line(tmp_path, old, new):
    text = ply_bytes(MESH).decode()
    assert old in text
    path = saved(tmp_path / "a.ply", text.replace(old, new).encode())
    with pytest.raises(SceneError) as caught:
        table_of(path, ["x"])
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_was_written_is_read_back_exactly(tmp_path, degree):
    """INRIA's properties in INRIA's order, as every viewer expects them."""
    g, path = random_gaussians(37, degree), tmp_path / "a.ply"
    write_ply(path, g)
    back = read_ply(path)
    for name in g.__slots__:
        np.testing.assert_array_equal(getattr(back, name), getattr(g, name))
    assert (read_frame_header(path).count, back.sh_degree) == (37, degree)
    header, _, body = path.read_bytes().partition(b"end_header\n")
    first, *lines = header.decode().split("property float ")
    rest = [f"f_rest_{i}" for i in range((0, 9, 24, 45)[degree])]
    names = ["x", "y", "z", "nx", "ny", "nz", *PROPERTIES[3:6], *rest, *PROPERTIES[6:]]
    assert first == "ply\nformat binary_little_endian 1.0\nelement vertex 37\n"
    assert [line.strip() for line in lines] == names
    assert len(body) == 37 * 4 * len(names)


def ascii_ply(names, rows):
    return ply_bytes({"vertex": [Column(n, "float", [row[i] for row in rows]) for i, n in enumerate(names)]})


def test_ascii_in_any_property_order_and_f_rest_is_channel_major_in_the_file(tmp_path):
    names = [*PROPERTIES[::-1], *(f"f_rest_{i}" for i in range(9))]
    g = read_ply(saved(tmp_path / "a.ply", ascii_ply(names, [list(range(len(names)))])))
    value = {n: float(i) for i, n in enumerate(names)}
    assert g.means.tolist() == [[value[n] for n in "xyz"]]
    assert g.quaternions.tolist() == [[value[f"rot_{i}"] for i in range(4)]]
    assert g.opacity_logits.tolist() == [value["opacity"]]
    assert (g.sh_rest[0] - value["f_rest_0"]).tolist() == [[0, 3, 6], [1, 4, 7], [2, 5, 8]]


@pytest.mark.parametrize(("kind", "scale"), [("uchar", 255), ("ushort", 65535), ("float", 1), ("double", 1)])
@pytest.mark.parametrize("form", ORDERS)
def test_points_have_colours_of_0_to_1(tmp_path, form, kind, scale):
    path, share = tmp_path / "a.ply", np.array([[0, 0.2, 1], [1, 0.6, 0.4]])
    values = np.round(share * scale) if scale > 1 else share
    places = [Column(n, "double", [i, -i]) for i, n in enumerate("xyz")]
    colour = [Column(n, kind, values[:, i]) for i, n in enumerate(("red", "green", "blue"))]
    positions, colours = read_points(saved(path, ply_bytes({"vertex": places + colour}, form)))
    assert positions.tolist() == [[0, 1, 2], [0, -1, -2]]
    np.testing.assert_allclose(colours, share, atol=1e-7)
    assert read_points(saved(path, ply_bytes({"vertex": places}, form)))[1] is None
    for elements in ({"vertex": places[:1]}, {"face": places}):
        with pytest.raises(SceneError, match=r"a\.ply: expected"):
            read_points(saved(path, ply_bytes(elements)))


BROKEN = [
    (b"", "expected a .ply header"),
    (b"not a ply at all\n", "expected a .ply header"),
    (ascii_ply(["x", "y", "z"], [[0, 0, 0]]), "missing f_dc_0"),
    (ascii_ply([*PROPERTIES, "f_rest_0"], [[0] * 15]), "expected 0, 9, 24 or 45 f_rest"),
    (ascii_ply([*PROPERTIES, *(f"f_rest_{i}" for i in range(1, 10))], [[0] * 23]), "missing f_rest_0"),
    (ascii_ply([*PROPERTIES, "log_duration"], [[0] * 15]), "got those of FTGS, which move"),
    (ascii_ply(PROPERTIES, [[0] * 14]).replace(b"vertex 1", b"vertex 9"), "truncated"),
]


@pytest.mark.parametrize(("content", "says"), [(None, "No such file"), *BROKEN])
def test_a_broken_file_is_refused_in_one_line(tmp_path, content, says):
    path = tmp_path / "bad.ply" if content is None else saved(tmp_path / "bad.ply", content)
    with pytest.raises(SceneError, match=says) as caught:
        read_ply(path)
    assert "bad.ply" in str(caught.value) and "\n" not in str(caught.value)
