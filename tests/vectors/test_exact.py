"""The decoder reads whole numbers as the vectors say: columns, positions, escapes and planes."""

import numpy as np
import pytest

from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import read_codes, row_places
from airgs_codec.coding.grid import grid_means
from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.coding.sidecar import read_detail, unpack_key_sidecar
from tests.faces import Atlas, FormatError, Grid, morton_decode, morton_encode
from tests.support.vectors import cases, data, label, numbers


def read_columns(case):
    """The columns of a file, each with what is expected, if the case says it."""
    reader, found = ColumnReader(data(case["data"]), "vector"), []
    for column in case["columns"]:
        listed = numbers(column["numbers"]) if "numbers" in column else None
        count = column["count"] if listed is None else len(listed)
        found.append((reader.column(count, column["order"]).tolist(), listed))
    reader.close()
    return found


@pytest.mark.parametrize("case", cases("columns"), ids=label)
def test_columns(case):
    for got, expected in read_columns(case):
        assert got == expected


def test_morton_codes():
    for case in cases("positions", "morton"):
        code, index = np.array([int(case["code"])], np.uint64), np.array([case["index"]])
        assert morton_encode(index) == code
        np.testing.assert_array_equal(morton_decode(code), index)


@pytest.mark.parametrize("case", cases("positions", "tiers"), ids=label)
def test_positions(case):
    grid, coarsest = Grid(**case["grid"]), case["qualities"][-1]["coarser"]
    shared = unpack_key_sidecar(data(case["data"]), case["rows"], grid, coarsest, "vector")
    for name in ("classes", "depths", "wider"):
        assert getattr(shared, name).tolist() == case[name]
    for quality in case["qualities"]:
        reader = ColumnReader(data(quality["data"]), "vector")
        sidecar = read_detail(reader, shared, grid, quality["coarser"], coarsest)
        assert not len(escapes.read_columns(reader, (1, 1, case["rows"])).index)
        reader.close()
        assert sidecar.codes.tolist() == numbers(quality["codes"])
        means = grid_means(sidecar.codes, sidecar.classes, sidecar.wider, grid, quality["coarser"])
        np.testing.assert_array_equal(means, quality["means"])


def read_tier(case):
    grid = Grid(**case["grid"])
    shared = unpack_key_sidecar(data(case["data"]), case["rows"], grid, case["coarsest"], "vector")
    reader = ColumnReader(data(case["detail"]), "vector")
    read_detail(reader, shared, grid, case["coarser"], case["coarsest"])
    escapes.read_columns(reader, (1, 1, case["rows"]))
    reader.close()


def unpack_kept(case):
    return unpack_key_sidecar(data(case["data"]), case["rows"], Grid([0] * 3, 1.0, 0), 0, "vector", True)


@pytest.mark.parametrize("case", cases("positions", "kept"), ids=label)
def test_depths_alone(case):
    found = unpack_kept(case)
    assert found.depths.tolist() == case["depths"] and not len(found.codes) and not len(found.classes)


def unpack_escapes(case):
    shape = tuple(case[name] for name in ("frames", "planes", "rows"))
    return escapes.unpack(data(case["data"]), shape, "vector")


@pytest.mark.parametrize("case", cases("escapes"), ids=label)
def test_escapes(case):
    found = unpack_escapes(case)
    for frame, expected in enumerate(case["bases"]):
        assert found.bases(frame).tolist() == [numbers(line) for line in expected]


REFUSED = [
    *((read_columns, case) for case in cases("columns", "refused")),
    *((read_tier, case) for case in cases("positions", "refused")),
    *((unpack_kept, case) for case in cases("positions", "kept_refused")),
    *((unpack_escapes, case) for case in cases("escapes", "refused")),
]


@pytest.mark.parametrize(("read", "case"), REFUSED, ids=lambda value: label(value) if isinstance(value, dict) else "")
def test_what_is_refused(read, case):
    with pytest.raises(FormatError) as caught:
        read(case)
    assert caught.value.reason == "bad_sidecar"


def test_places_in_a_plane():
    for case in cases("planes", "places"):
        stride = case["plane_width"]
        line, column = divmod(int(row_places(case["row"] + 1, stride, stride)[-1]), stride)
        assert [column, line] == case["place"]


@pytest.mark.parametrize("case", cases("planes"), ids=label)
def test_pictures(case):
    fields = ("rows", "centres", "planes", "plane_width", "columns", "width", "height")
    atlas = Atlas(**{name: case[name] for name in fields})
    luma = np.frombuffer(data(case["luma"]), np.uint8)
    bases = np.array([numbers(line) for line in case["bases"]], np.int32).reshape(len(atlas.planes), atlas.rows)
    expected = [numbers(line) for line in case["codes"]]
    if atlas.planes:
        pages = luma.reshape(atlas.pages * atlas.height, atlas.width)
        assert read_codes(pages, atlas, bases).tolist() == expected
    else:  # there is no picture to read
        assert [[centre] * atlas.rows for centre in atlas.centres] == expected
