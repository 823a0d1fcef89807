"""The rivals: their fields against plain references, what is sent comes back, a stopped run goes on."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch
from scipy.stats import norm

from airgs_codec.errors import ConfigError
from airgs_codec.progress import silent
from airgs_codec.scene.formats.ply import read_ply
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.data.readers import open_scene
from airgs_codec.trainer.fit.losses import mean_psnr
from tests.support.scenes import random_gaussians
from tests.support.training import SETTINGS, write_blobs
from tests.support.views import coloured_cloud
from tools.lab.baselines import rivals
from tools.lab.baselines.fourdgs import (
    MODEL,
    PAIRS,
    Field,
    FieldSize,
    Fourdgs,
    deformed,
    read_model,
    spread,
    write_model,
)
from tools.lab.baselines.hashgrid import FieldSettings, HashField
from tools.lab.baselines.method import Footage, Shown, frame_path, mean_bytes, run_method
from tools.lab.baselines.stream3dgs import Region, Stream3dgs, StreamSettings, decode, region_of
from tools.lab.baselines.threedgs import Naive3dgs, Timetable
from tools.lab.baselines.v3 import V3, V3Settings, estimated_bits
from tools.lab.rd.layouts import v3_layout

BOX = np.array([[-1.0, 0.0, 2.0], [1.0, 3.0, 2.5]])
GRID = FieldSettings(levels=4, features=3, log2_table=7, coarsest=3, growth=1.6, width=8)  # 3, 4, 7 and 12 cells
SIZE = FieldSize(cells=5, moments=3, features=2, resolutions=(1, 2), width=4)
LOW, HIGH = torch.tensor([-1.0, -2.0, 0.0]), torch.tensor([1.0, 2.0, 3.0])
CACHE = FieldSettings(levels=3, features=2, log2_table=8, coarsest=4, width=16)
STREAM = StreamSettings(
    replace(SETTINGS, first_iterations=60), CACHE, iterations=40, added_iterations=20, coarse=0.0, most_added=30
)
V3_SMALL = V3Settings(
    group_frames=2, rows=150, sh_degree=0, key_iterations=60, finetune_iterations=20, field_iterations=10,
    frame_iterations=20, qp=14,
)  # fmt: skip


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return open_scene(write_blobs(tmp_path_factory.mktemp("scene") / "blobs"), frames=(0, 3))


def footage_of(scene, folder):
    return Footage(Pictures(scene), len(scene), scene.points, folder)


def corners(place, cells):
    """The first vertex of a cell, and each corner of it with its weight; `place` in cells."""
    low = np.minimum(np.floor(place), np.asarray(cells) - 1).astype(int)
    for corner in itertools.product((0, 1), repeat=len(place)):
        yield low + corner, np.prod(1 - np.abs(place - low - corner))


def entry(vertex, cells):
    """Number of a vertex in the table of its level, in plain integers."""
    i, j, k = (int(v) for v in vertex)
    if (cells + 1) ** 3 <= 128:
        return i + (cells + 1) * (j + (cells + 1) * k)
    return (i ^ (j * 2654435761) % 2**32 ^ (k * 805459861) % 2**32) % 128


def test_features_of_a_hash_grid_are_interpolated_between_eight_vertices():
    grid = HashField(GRID, BOX, 2).double()
    points = np.concatenate([np.random.default_rng(0).uniform(*BOX, (50, 3)), BOX])
    found, table = grid.encoded(grid.places(points)).detach().numpy(), grid.table.detach().numpy()
    assert GRID.cells() == [3, 4, 7, 12] and GRID.entries() == [64, 125, 128, 128]
    for point, features in zip((points - BOX[0]) / (BOX[1] - BOX[0]), found, strict=True):
        wanted, begin = [], 0
        for cells, entries in zip(GRID.cells(), GRID.entries(), strict=True):
            parts = [w * table[begin + entry(v, cells)] for v, w in corners(point * cells, [cells] * 3)]
            wanted, begin = [*wanted, np.sum(parts, axis=0)], begin + entries
        np.testing.assert_allclose(features, np.concatenate(wanted), rtol=1e-12, atol=1e-16)


def test_what_is_sent_of_a_hash_grid_is_every_number_in_float16():
    grid, other = HashField(GRID, BOX, 2, seed=1), HashField(GRID, BOX, 2, seed=2)
    data = grid.to_bytes()
    assert len(data) == 2 * (445 * 3 + 12 * 8 + 8 + 8 * 8 + 8 + 8 * 2 + 2)
    other.load_bytes(data)
    assert other.to_bytes() == data and torch.equal(other.table, grid.table.detach().half().float())
    with pytest.raises(ConfigError, match="3058 bytes of a field, got 6"):
        grid.load_bytes(bytes(6))


def shaken(planes):
    """A field with other numbers everywhere, as if it had learnt."""
    draw = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for p in planes.parameters():
            p.add_(0.3 * torch.randn(p.shape, generator=draw))
    return planes


def test_features_of_4dgs_are_products_of_six_planes_at_each_resolution():
    planes = shaken(Field(SIZE, LOW, HIGH, 0))
    points = torch.rand(6, 3) * 1.4 * (HIGH - LOW) + LOW  # some are beyond the box
    for point, found in zip(points.numpy(), planes.encode(points, 0.3).detach().numpy(), strict=True):
        unit = np.clip([*((point - LOW.numpy()) / (HIGH - LOW).numpy()), 0.3], 0, 1)
        wanted = []
        for k in range(2):
            product = np.ones(SIZE.features)
            for (a, b), plane in zip(PAIRS, planes.planes[6 * k : 6 * k + 6], strict=True):
                numbers = plane[0].detach().numpy()
                cells = np.array(numbers.shape[1:]) - 1
                product *= sum(w * numbers[:, *v] for v, w in corners(unit[[b, a]] * cells, cells))
            wanted.append(product)
        assert found == pytest.approx(np.concatenate(wanted), rel=1e-4, abs=1e-5)


def test_a_model_of_4dgs_comes_back_from_its_files_exactly(tmp_path):
    g, planes = coloured_cloud(8), shaken(Field(SIZE, LOW, HIGH, 0))
    total = write_model(tmp_path / MODEL, g, planes)
    assert total == sum(path.stat().st_size for path in (tmp_path / MODEL).iterdir())
    again = Field(SIZE, LOW, HIGH, 1)
    shown, wanted = deformed(read_model(tmp_path / MODEL, again), again, 0.4), deformed(g, planes, 0.4)
    assert all(np.array_equal(getattr(shown, n), getattr(wanted, n)) for n in g.__slots__)
    assert {n for n in g.__slots__ if not np.array_equal(getattr(shown, n), getattr(g, n))} == {
        "means", "log_scales", "quaternions",
    }  # fmt: skip
    assert sum(spread(total, 7)) == total and max(spread(total, 7)) - min(spread(total, 7)) <= 1


def test_frames_of_4dgs_pay_for_the_model(scene, tmp_path):
    shown = list(Fourdgs(iterations=40, sh_degree=0, points=60, cells=8).frames(footage_of(scene, tmp_path), 0, silent))
    assert [one.kind for one in shown] == ["key", "frame", "frame"]
    assert sum(one.bytes for one in shown) == sum(path.stat().st_size for path in (tmp_path / MODEL).iterdir())


def test_bytes_of_3dgstream_are_those_of_what_a_viewer_decodes(scene, tmp_path):
    frames = run_method(Stream3dgs(STREAM), footage_of(scene, tmp_path))
    before = first = read_ply(frame_path(tmp_path, 0))
    region = region_of(first, STREAM.share)
    assert frames[0].bytes == frame_path(tmp_path, 0).stat().st_size
    cache = region.new_cache(CACHE).nbytes
    for t in (1, 2):
        data = frame_path(tmp_path, t).with_suffix(".stream").read_bytes()
        assert frames[t].bytes == len(data) == cache + 4 * 14 * (frames[t].gaussians - len(first))
        shown, kept = decode(before, data, CACHE, region), read_ply(frame_path(tmp_path, t))
        for name in shown.__slots__:
            np.testing.assert_array_equal(getattr(shown, name), getattr(kept, name))
        before = shown.take(slice(len(first)))


def test_data_of_3dgstream_that_is_cut_is_refused():
    g, region = random_gaussians(10, 1), Region(np.array([[-1.0] * 3, [1.0] * 3]))
    data = region.new_cache(CACHE).to_bytes()
    kept = decode(g, data, CACHE, region)  # a new cache changes nothing
    assert all(np.array_equal(getattr(kept, name), getattr(g, name)) for name in g.__slots__)
    with pytest.raises(ConfigError, match="Gaussians of 92 bytes, got 5"):
        decode(g, data + bytes(5), CACHE, region)


def test_what_v3_shows_is_what_its_bytes_decode_to_and_a_stopped_group_begins_anew(scene, tmp_path, monkeypatch):
    coded = []

    def layout(group, *settings):
        coded.append((group, v3_layout(group, *settings)))
        return coded[-1][1]

    monkeypatch.setattr("tools.lab.baselines.v3.v3_layout", layout)
    footage = footage_of(scene, tmp_path)
    shown = list(V3(V3_SMALL).frames(footage, 0, silent))
    assert [one.kind for one in shown] == ["key", "frame", "key"] and shown[0].bytes > shown[1].bytes > 0
    assert [one.bytes for one in shown] == [size for _, group in coded for size in group.frame_bytes]
    assert shown[1].gaussians is coded[0][1].frames[1] and len(shown[0].gaussians) <= V3_SMALL.rows
    assert not np.array_equal(shown[1].gaussians.means, coded[0][0][1].means)  # decoded, not as it was trained
    again = list(V3(V3_SMALL).frames(footage, 1, silent))
    assert [one.bytes for one in again] == [one.bytes for one in shown[1:]]


def test_bits_of_v3_are_those_of_a_normal_distribution():
    samples, expected = np.random.default_rng(0).normal([0, 3, -20], [0.4, 2, 50], (40, 3)), 0.0
    for column in samples.T:
        mean, deviation = column.mean(), np.sqrt(column.var() + 1e-6)
        p = [norm.cdf((x + 0.5 - mean) / deviation) - norm.cdf((x - 0.5 - mean) / deviation) for x in column]
        expected += np.mean(-np.log2(p))
    assert float(estimated_bits(torch.from_numpy(samples))) == pytest.approx(expected, rel=1e-9)
    far = torch.zeros(5000, 1)
    far[0] = 1e4
    assert torch.isfinite(estimated_bits(far)) and torch.isfinite(estimated_bits(torch.ones(1, 2)))


def test_frames_of_3dgs_are_learnt_alone_and_cost_their_files(scene, tmp_path):
    footage = replace(footage_of(scene, tmp_path), frames=2)
    method = Naive3dgs(iterations=100, sh_degree=1, points=60)
    for t, frame in enumerate(run_method(method, footage)):
        g, views = read_ply(frame_path(tmp_path, t)), footage.pictures.train(t)
        assert (frame.kind, frame.bytes, frame.gaussians) == ("key", frame_path(tmp_path, t).stat().st_size, len(g))
        assert mean_psnr(g, views) > mean_psnr(replace(method, iterations=1).fit(footage, t, silent), views) + 3


def test_the_timetable_of_3dgs_is_the_papers_and_shrinks_with_the_run():
    paper = Timetable()
    assert [i for i in range(1, 30_001) if paper.densifies(i)] == list(range(600, 15_000, 100))
    assert [i for i in range(1, 30_001) if paper.resets(i)] == [3_000, 6_000, 9_000, 12_000]
    assert paper.scaled(0.1) == Timetable(50, 1_500, 100, 750)


@dataclass
class Growing:
    """Frame t has t + 10 Gaussians and 100 t bytes; it stops before frame `until`, as if it were killed."""

    name: str = "growing"
    settings: dict[str, object] = field(default_factory=lambda: {"rate": 0.1})
    until: int = 99
    asked: list[int] = field(default_factory=list)

    def frames(self, footage, done, progress):
        self.asked.append(done)
        for t in range(done, footage.frames):
            if t == self.until:
                raise KeyboardInterrupt
            yield Shown("frame" if t else "key", random_gaussians(t + 10), 100 * t, 0.5)


def test_a_stopped_run_goes_on_where_it_stopped_and_another_one_is_refused(scene, tmp_path):
    footage, method = footage_of(scene, tmp_path), Growing(until=2)
    with pytest.raises(KeyboardInterrupt):
        run_method(method, footage)
    method.until = 99
    frames = run_method(method, footage)
    assert method.asked == [0, 2] and mean_bytes(frames) == 100 and run_method(method, footage) == frames
    assert [(f.kind, f.gaussians, f.bytes) for f in frames] == [("key", 10, 0), ("frame", 11, 100), ("frame", 12, 200)]
    for other in (Growing(settings={"rate": 0.2}), Growing(name="other")):
        with pytest.raises(ConfigError, match="these settings"):
            run_method(other, footage)
    with pytest.raises(ConfigError, match="these settings"):
        run_method(method, replace(footage, source={"size": 160}))


def test_settings_of_rivals_are_those_that_run():
    found = {(method, what): (here, paper) for method, what, here, paper in rivals.settings_of()}
    v3 = V3Settings()
    assert found["V³", "iterations of a keyframe"] == (v3.key_iterations + v3.finetune_iterations, 16_000)
    assert found["naive 3DGS", "gradient from which Gaussians are added"] == (4e-4, 2e-4)
