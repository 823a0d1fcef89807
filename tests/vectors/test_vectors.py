"""The decoder reads what the vectors say: whole numbers exactly, others as near as FORMAT.md asks, whole packages."""

from functools import partial

import numpy as np
import pytest
import torch

from airgs_codec.coding import atlas, channels, escapes, sidecar
from airgs_codec.coding.motion import motion_units
from airgs_codec.coding.rangecoder import ColumnReader
from airgs_codec.render.reference import sh_values
from tests import faces
from tests.faces import DELTA, KEYFRAME, FormatError, Grid, from_codes, unpack_matrix
from tests.makers.vectors.__main__ import make
from tests.support.paths import REPOSITORY, VECTORS
from tests.support.session_packages import long_index
from tests.support.vectors import cases, data, numbers

MOST_BYTES = 600_000
MOST_REQUESTS = 6, 9  # before the first picture: of a group without kept rows, and of one with
CHANNELS = (3, 12, 27, 48)  # of colour, by SH degree
FRAMES = np.frombuffer((VECTORS / "packages.bin").read_bytes(), "<f4")


def label(case):
    names = ("name", "package", "count", "number", "path", "frame", "quality", "level", "tiers")
    return " ".join(str(case[name]) for name in names if name in case) if isinstance(case, dict) else ""


def each(name, part="cases"):
    return pytest.mark.parametrize("case", cases(name, part), ids=label)


def test_the_vectors_are_made_anew_alike_small_and_named_in_their_page():
    made, page = make(), VECTORS / "README.md"
    assert sorted([*made, page.name]) == sorted(path.name for path in VECTORS.iterdir())
    for name, content in made.items():
        assert (VECTORS / name).read_bytes() == content, f"{name}: run python -m tests.makers.vectors"
        assert f"`{name}`" in page.read_text()
    assert sum(path.stat().st_size for path in VECTORS.iterdir()) < MOST_BYTES


def read_columns(case):
    """The columns of a file, each with what is expected, if the case says it."""
    reader, found = ColumnReader(data(case["data"]), "vector"), []
    for column in case["columns"]:
        listed = numbers(column["numbers"]) if "numbers" in column else None
        count = column["count"] if listed is None else len(listed)
        found.append((reader.column(count, column["order"]).tolist(), listed))
    reader.close()
    return found


@each("columns")
def test_columns(case):
    assert all(got == expected for got, expected in read_columns(case))


def test_morton_codes_and_places_in_a_plane():
    for case in cases("positions", "morton"):
        code, index = np.array([int(case["code"])], np.uint64), np.array([case["index"]])
        assert faces.morton_encode(index) == code
        np.testing.assert_array_equal(faces.morton_decode(code), index)
    for case in cases("planes", "places"):
        stride = case["plane_width"]
        line, column = divmod(int(atlas.row_places(case["row"] + 1, stride, stride)[-1]), stride)
        assert [column, line] == case["place"]


def unpack_sidecar(case, coarsest=0, depths_alone=False):
    cells = Grid(**case["grid"]) if "grid" in case else Grid([0] * 3, 1.0, 0)
    return sidecar.unpack_keyframe_sidecar(data(case["data"]), case["rows"], cells, coarsest, "vector", depths_alone)


def read_detail(shared, case, text, *coarser):
    """The positions of a quality, whose picture has no escapes."""
    reader = ColumnReader(data(text), "vector")
    detail = sidecar.read_detail(reader, shared, Grid(**case["grid"]), *coarser)
    assert not len(escapes.read_columns(reader, (1, 1, case["rows"])).index)
    reader.close()
    return detail


@each("positions", "tiers")
def test_positions(case):
    coarsest = case["qualities"][-1]["coarser"]
    shared = unpack_sidecar(case, coarsest)
    for name in ("classes", "depths", "wider"):
        assert getattr(shared, name).tolist() == case[name]
    for quality in case["qualities"]:
        found = read_detail(shared, case, quality["data"], quality["coarser"], coarsest)
        assert found.codes.tolist() == numbers(quality["codes"])
        means = sidecar.grid_means(found.codes, found.classes, found.wider, Grid(**case["grid"]), quality["coarser"])
        np.testing.assert_array_equal(means, quality["means"])


def read_tier(case):
    shared = unpack_sidecar(case, case["coarsest"])
    read_detail(shared, case, case["detail"], case["coarser"], case["coarsest"])


@each("positions", "inter")
def test_depths_alone(case):
    found = unpack_sidecar(case, depths_alone=True)
    assert found.depths.tolist() == case["depths"] and not len(found.codes) and not len(found.classes)


def unpack_escapes(case):
    shape = tuple(case[name] for name in ("frames", "planes", "rows"))
    return escapes.unpack_segment(data(case["data"]), shape, False, "vector")[1]


@each("escapes")
def test_escapes(case):
    found = unpack_escapes(case)
    for frame, expected in enumerate(case["bases"]):
        assert found.bases(frame).tolist() == [numbers(line) for line in expected]


REFUSED = [
    *((read_columns, case) for case in cases("columns", "refused")),
    *((read_tier, case) for case in cases("positions", "refused")),
    *((partial(unpack_sidecar, depths_alone=True), case) for case in cases("positions", "inter_refused")),
    *((unpack_escapes, case) for case in cases("escapes", "refused")),
]


@pytest.mark.parametrize(("read", "case"), REFUSED, ids=label)
def test_what_is_refused(read, case):
    with pytest.raises(FormatError) as caught:
        read(case)
    assert caught.value.reason == "bad_sidecar"


@each("planes")
def test_pictures(case):
    fields = ("rows", "centres", "planes", "plane_width", "columns", "width", "height")
    layout = faces.Atlas(**{name: case[name] for name in fields})
    luma = np.frombuffer(data(case["luma"]), np.uint8)
    bases = np.array([numbers(line) for line in case["bases"]], np.int32).reshape(len(layout.planes), layout.rows)
    expected = [numbers(line) for line in case["codes"]]
    if layout.planes:
        pages = luma.reshape(layout.pages * layout.height, layout.width)
        assert atlas.read_codes(pages, layout, bases).tolist() == expected
    else:  # there is no picture to read
        assert [[centre] * layout.rows for centre in layout.centres] == expected


def shown(g):
    alpha = 1 / (1 + np.exp(-g.opacity_logits.astype(np.float64)))
    parts = {"means": g.means, "quaternions": g.quaternions, "log_scales": g.log_scales, "alpha": alpha}
    return parts | {"colours": channels.colours(g.sh_dc, g.sh_rest)}


def assert_near(got, expected):
    """Every attribute of every row is as near to its value as its tolerance asks."""
    for name, values in expected["values"].items():
        want, tolerance = (np.array(one, np.float64) for one in (values, expected["tolerance"][name]))
        away = np.abs(np.asarray(got[name], np.float64) - want).reshape(len(want), -1).max(axis=1, initial=0.0)
        assert (away <= tolerance).all(), f"{name}: {away} off, at most {tolerance}"


@each("keyframes")
def test_keyframes(case):
    width, steps = CHANNELS[case["sh_degree"]], faces.KeyframeSteps(**case["steps"])
    codes = np.array(case["codes"], np.int32)
    values = from_codes(codes, KEYFRAME.steps(steps, width) * case["factor"], case["gain"])
    nowhere = (np.zeros(codes.shape[1], kind) for kind in (np.uint64, np.int16, np.int16, np.uint8))
    transform = unpack_matrix(case["colour_transform"], width)
    of = sidecar.KeyframeSidecar(*nowhere), transform, Grid(**case["grid"]), steps
    key = channels.dequantise_keyframe(values, *of)
    names = {"quaternions": key.quaternions, "log_scales": key.log_scales, "alpha": key.opacity, "colours": key.colour}
    assert_near(names, case)


@each("deltas")
def test_deltas(case):
    space, width, steps = case["canonical"], CHANNELS[case["sh_degree"]], faces.DeltaSteps(**case["steps"])
    base = channels.Canonical(
        means=np.array(space["means"], np.float64),
        motion_units=motion_units(np.array(space["classes"], np.int16)),
        opacity=np.array(space["alpha"], np.float32),
        depths=np.array(space["depths"], np.uint8),
        transform=unpack_matrix(case["colour_transform"], width),
        **{name: np.array(space[name], np.float32) for name in ("quaternions", "log_scales")},
        colour=np.array(space["colours"], np.float32),
    )
    rows = np.flatnonzero((base.depths >= case["level"]) & (base.depths != 255))
    assert rows.tolist() == case["rows"]
    widths = DELTA.steps(steps, width) * case["factor"]
    applier = channels.DeltaApplier(base, rows, steps)
    for place, frame in enumerate(case["frames"]):
        codes = np.array(frame["codes"], np.int32)[:, : len(rows)]
        values = from_codes(codes, widths, case["gain"])
        if "slopes" in case:
            slopes = from_codes(np.array(case["slopes"], np.int32), widths, case["gain"])
            values += np.float32(atlas.slope_times(len(case["frames"]))[place]) * slopes
        assert_near(shown(applier.apply(values)), frame)
    if not len(rows):  # without states it is shown alike
        assert_near(shown(base.to_gaussians()), case["frames"][0])


def test_covariances_and_colours_from_directions():
    for case in cases("shown", "covariances"):
        spread = faces.to_matrices(np.array(case["quaternion"])) * np.exp(case["log_scales"])
        np.testing.assert_allclose(spread @ spread.T, case["covariance"], rtol=0, atol=case["tolerance"])
    for case in cases("shown", "colours"):
        directions, sh = (torch.tensor([case[name]], dtype=torch.float64) for name in ("direction", "coefficients"))
        colour = (sh_values(directions, sh)[0] + 0.5).clamp_min(0).numpy()
        assert np.abs(colour - case["colour"]).max() <= case["tolerance"]


def show(case):
    package = faces.open_package(REPOSITORY / case["package"])
    rung = {"level": case["level"], "keyframe_quality": case["quality"], "tiers": case["tiers"]}
    return next(faces.decode_frames(package, case["frame"], case["frame"] + 1, **rung)).gaussians


@each("packages", "groups")
def test_groups_and_their_files(case):
    m, number = faces.open_package(REPOSITORY / case["package"]).manifest, case["number"] - 1
    group, levels = m.groups[number], range(len(m.levels))
    assert (group.start, group.stop, faces.group_path(number + 1)) == (case["start"], case["stop"], case["table"])
    for tier, (keyframe_sidecar, pictures) in enumerate(zip(case["sidecars"], case["pictures"], strict=True)):
        for quality, picture in enumerate(pictures):
            assert m.keyframe_files(number, tier, quality) == [path for path in (keyframe_sidecar, picture) if path]
    for segment, expected in zip(m.segments_of(number), case["segments"], strict=True):
        found = m.segments[segment]
        assert (found.start, found.stop) == (expected["start"], expected["stop"])
        assert [m.delta_files(segment, j) for j in levels] == [[path] if path else [] for path in expected["files"]]


@each("packages", "index")
def test_the_way_to_a_group_of_a_long_package(case):
    index, pages = long_index(case["count"])
    places = faces.GroupIndex(index, lambda path, _: pages[path])
    assert [len(spans) for spans in index] == case["entries"] and places.groups == case["count"]
    assert places.at_frame(case["frame"]) == places.at_segment(case["frame"]) == case["number"] - 1
    assert list(places.pages_to("segments", case["frame"])) == case["pages"]
    assert list(places.pages_to("groups", case["number"] - 1)) == case["pages"]


@each("packages", "startup")
def test_what_is_fetched_before_the_first_picture(case, monkeypatch):
    opened, read = [], faces.Folder.open
    monkeypatch.setattr(faces.Folder, "open", lambda folder, path: opened.append(path) or read(folder, path))
    show(case)
    asked = opened[1:]  # the MPD is of DASH players
    assert asked == case["files"]
    tables = [path for path in asked if path.startswith("group/")]
    assert case["tiers"] > 1 or len(asked) <= MOST_REQUESTS[len(tables) - 1]


@each("packages", "frames")
def test_frames(case):
    at = case["offset"] // 4
    for name, got in shown(show(case).take(np.array(case["rows"]))).items():
        expected = FRAMES[at : at + got.size].reshape(got.shape)
        assert np.abs(got - expected).max() <= case["tolerance"][name], name
        at += got.size
