"""The PLY container: one table in every form and order reads the same, and what is cut or absurd is refused at once."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airgs_codec.scene.formats.ply_elements import BLOCK, MOST_ELEMENTS, MOST_PROPERTIES, read_columns, read_header
from tests.faces import SceneError
from tests.support.ply import ORDERS, TYPES, Column, ply_bytes

NUMBERS = {
    name: st.integers(int(np.iinfo(kind).min), int(np.iinfo(kind).max))
    if kind[0] != "f"
    else st.floats(width=8 * int(kind[1]), allow_nan=True, allow_infinity=True)
    for name, kind in TYPES.items()
}


@st.composite
def columns(draw, rows, names):
    kinds = draw(st.lists(st.sampled_from(sorted(TYPES)), min_size=len(names), max_size=len(names)))
    return [
        Column(n, k, draw(st.lists(NUMBERS[k], min_size=rows, max_size=rows)))
        for n, k in zip(names, kinds, strict=True)
    ]


@st.composite
def neighbours(draw):
    rows = draw(st.integers(0, 4))
    out = draw(columns(rows, draw(st.permutations(["red", "x"]))))
    if draw(st.booleans()):
        lists = draw(st.lists(st.lists(st.integers(0, 255), max_size=5), min_size=rows, max_size=rows))
        out.insert(
            draw(st.integers(0, 2)), Column("vertex_indices", "int", lists, draw(st.sampled_from(["uchar", "int"])))
        )
    return out


def table_of(path, names):
    header = read_header(path)
    return read_columns(path, header, header.element("vertex"), [names])[0]


@given(st.data())
@settings(max_examples=150)
def test_ascii_little_and_big_endian_give_the_same_table(tmp_path_factory, data):
    """Whatever stands before and after, in any order of properties and types, with comments and CR LF."""
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    vertex = data.draw(columns(data.draw(st.integers(0, 6)), data.draw(st.permutations(["x", "y", "z", "w"]))))
    elements = {"vertex": vertex}
    if data.draw(st.booleans()):
        elements = {"before": data.draw(neighbours()), **elements}
    if data.draw(st.booleans()):
        elements["face"] = data.draw(neighbours())
    comments = data.draw(
        st.lists(st.sampled_from(["comment", "comment end_header", "obj_info property float x"]), max_size=3)
    )
    wanted = np.array([np.array(c.values, np.result_type("f4", *(TYPES[c.type] for c in vertex))) for c in vertex]).T
    for form in ORDERS:
        for newline in ("\n", "\r\n"):
            path.write_bytes(ply_bytes(elements, form, newline, comments))
            np.testing.assert_array_equal(table_of(path, [c.name for c in vertex]), wanted.reshape(-1, 4))


@pytest.mark.parametrize("form", ORDERS)
def test_more_rows_than_a_block_are_all_read(tmp_path, form):
    values = np.random.default_rng(0).normal(size=2 * BLOCK + 5).astype("f4")
    elements = {"before": [Column("i", "int", range(3))], "vertex": [Column("x", "float", values)]}
    (tmp_path / "a.ply").write_bytes(ply_bytes(elements, form))
    np.testing.assert_array_equal(table_of(tmp_path / "a.ply", ["x"])[:, 0], values)


MESH = {
    "before": [Column("corners", "int", [[1, 2, 3], [4]], "uchar")],
    "vertex": [Column("x", "float", [1.5, 2.5]), Column("n", "uchar", [7, 8])],
}


@pytest.mark.parametrize("form", ORDERS)
def test_a_file_cut_anywhere_is_refused(tmp_path, form):
    path, whole = tmp_path / "a.ply", ply_bytes(MESH, form)
    cut = 1 if form != "ascii" else 3  # a line may lack its end, and 8 its newline
    for end in range(len(whole) - cut + 1):
        path.write_bytes(whole[:end])
        with pytest.raises(SceneError) as caught:
            table_of(path, ["x", "n"])
        assert "\n" not in str(caught.value) and "a.ply" in str(caught.value)


@pytest.mark.parametrize("form", ORDERS)
@pytest.mark.parametrize("element", ["before", "vertex"])
def test_absurd_counts_are_refused_before_memory_is_taken(tmp_path, form, element):
    path = tmp_path / "a.ply"
    for count in (10**6, 10**17):
        text = ply_bytes(MESH, form).replace(f"element {element} 2".encode(), f"element {element} {count}".encode())
        path.write_bytes(text)
        tracemalloc.start()
        with pytest.raises(SceneError, match="truncated"):
            table_of(path, ["x"])
        assert tracemalloc.get_traced_memory()[1] < 3e6
        tracemalloc.stop()


@pytest.mark.parametrize("form", ORDERS)
def test_a_header_declares_no_more_than_a_scene_can_need(tmp_path, form):
    path = tmp_path / "a.ply"
    vertex = [Column(f"p{i}", "uchar", [i % 256]) for i in range(MOST_PROPERTIES - MOST_ELEMENTS + 1)]
    elements = {f"e{i}": [Column("x", "uchar", [])] for i in range(MOST_ELEMENTS - 1)} | {"vertex": vertex}
    path.write_bytes(ply_bytes(elements, form))
    assert table_of(path, ["p7"])[0, 0] == 7
    for more, got in (
        ({"more": [Column("x", "uchar", [])]}, f"{MOST_ELEMENTS + 1} elements and {MOST_PROPERTIES + 1} properties"),
        ({f"e{i}": [Column("x", "uchar", [])] for i in range(20_000)}, "20001 elements"),
        ({"vertex": [Column(f"p{i}", "uchar", [1]) for i in range(45_000)]}, "45063 properties"),
    ):
        path.write_bytes(ply_bytes(elements | more, form))
        with pytest.raises(SceneError, match=f"{MOST_ELEMENTS} elements and {MOST_PROPERTIES} properties, got .*{got}"):
            read_header(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("ply\n", "ply"),
        ("format ascii 1.0", "format ascii 2.0"),
        ("format ascii 1.0", "comment"),
        ("element vertex 2", "element vertex -2"),
        ("element vertex 2", "element vertex two"),
        ("element vertex 2", f"element vertex {'9' * 5000}"),
        ("float x", "real x"),
        ("float x", "float"),
        ("list uchar", "list float"),
        ("uchar n", "uchar x"),
        ("element before", "element vertex"),
        ("end_header", "end"),
        ("element vertex 2", "element vertex 2\nproperty list uchar int more"),
        ("1.5", "one"),
        ("1.5 7", "1.5"),
        ("1.5 7", "1.5 300"),
        ("1.5 7", "1.5 7.5"),
    ],
)
def test_what_is_not_well_formed_is_refused_in_one_line(tmp_path, old, new):
    text = ply_bytes(MESH).decode()
    assert old in text
    (tmp_path / "a.ply").write_text(text.replace(old, new))
    with pytest.raises(SceneError) as caught:
        table_of(tmp_path / "a.ply", ["x"])
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian"])
def test_a_list_of_negative_length_is_refused(tmp_path, form):
    elements = {"before": [Column("corners", "int", [[]], "int")], **{"vertex": MESH["vertex"]}}
    data = ply_bytes(elements, form)
    at = data.index(b"end_header\n") + len(b"end_header\n")
    (tmp_path / "a.ply").write_bytes(data[:at] + b"\xff" * 4 + data[at + 4 :])
    with pytest.raises(SceneError, match="list of -1"):
        table_of(tmp_path / "a.ply", ["x"])
