"""The dense level space: bytes and qualities that fall, tables, and a picture."""

from dataclasses import replace

import pytest

from airgs_codec.errors import ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.package.region import draw_views
from tests.support.manifests import with_segments
from tests.support.paths import FOX, VALID
from tests.support.views import ring
from tools.lab.command import Lab
from tools.lab.page import text_of, write_picture
from tools.lab.paper import dense
from tools.lab.paper.dense import (
    DROP,
    HOLD,
    Options,
    measure_dense,
    page,
    pruning_levels,
    run,
    saving_levels,
    split_at_cliff,
)
from tools.lab.paper.states import MEASURED, measured_views


@pytest.fixture(scope="module")
def moving():
    return open_package(VALID / "moving")


@pytest.fixture(scope="module")
def cameras(moving):
    return draw_views(moving.manifest.region, 3, 5)


def test_dense_levels_fall_and_bytes_are_those_of_the_package(moving, cameras, tmp_path, monkeypatch):
    monkeypatch.setattr(dense, "FACTORS", (1.0, 2.0))
    monkeypatch.setattr(dense, "FRAMES", 1)
    measured = [
        replace(s, levels=[replace(v, psnr=[45.0, 40.0], ssim=[0.99, 0.98]) for v in s.levels])
        for s in moving.manifest.segments
    ]
    package = replace(moving, manifest=with_segments(moving.manifest, measured))
    levels_of_all = measure_dense(package, cameras[:1], cameras)
    m = package.manifest
    full = sum(m.bytes_of(m.state_files(i, 0)) for i in range(len(m.segments)))
    for name in MEASURED:
        levels = pruning_levels(levels_of_all, name)
        assert [p.pruning.pruned for p in levels] == [i / 10 for i in range(11)]
        assert levels[0].psnr == pytest.approx(45.0) and levels[0].bytes == full
        assert levels[-1].bytes == 0 and levels[-1].psnr < levels[0].psnr
        (dropped,) = (p for p in pruning_levels(levels_of_all, name, DROP) if p.pruning.pruned == 1)
        assert dropped.psnr < levels[-1].psnr
    sizes = [p.bytes for p in saving_levels(levels_of_all)]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] <= full
    kept, left = split_at_cliff(pruning_levels(levels_of_all, "hits", HOLD))
    assert kept[0].pruning.pruned == 0 and len(kept) + len(left) == 10
    made = page(levels_of_all, m.frames)
    assert "last level before the cliff saves" in text_of(made)
    assert {row["pruned"] for row in made.tables()[0].rows} >= {0.0, 1.0}
    write_picture(made.sections[0].pictures[0], tmp_path / "dense.png")
    assert (tmp_path / "dense.png").stat().st_size > 10_000


def test_an_original_of_other_length_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="expected 4 frames, got 10"):
        run(Options(VALID / "moving", FOX), Lab.at(tmp_path, quiet=True))


def test_dense_levels_need_a_measured_top_rung(moving, cameras):
    segments = [replace(s, levels=[replace(v, psnr=[], ssim=[]) for v in s.levels]) for s in moving.manifest.segments]
    bare = replace(
        moving,
        manifest=with_segments(
            replace(moving.manifest, views=replace(moving.manifest.views, reference="none")), segments
        ),
    )
    with pytest.raises(ConfigError, match="--against"):
        measure_dense(bare, cameras[:1], cameras)


def test_held_out_cameras_are_measured_on():
    views = ring(8, held_out=2)
    assert measured_views(views) == views[6:]
    for split in ("train", "test"):  # where there is no choice, all serve
        alike = [replace(v, split=split) for v in views]
        assert [v.name for v in measured_views(alike)] == [views[i].name for i in (0, 2, 5, 7)]
