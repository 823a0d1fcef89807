"""The dense level space: bytes and qualities that fall, tables, and a picture."""

from dataclasses import replace

import pytest

from airgs_codec.cli.manifest import main as manifest_main
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.dense import DROP, HOLD, MEASURED, measure_dense, pruning_levels, saving_levels, split_at_cliff
from airgs_codec.package.region import draw_views
from airgs_codec.package.store import open_package
from tests.support.manifests import with_segments
from tests.support.paths import FOX, VALID

MOVING = str(VALID / "moving")


@pytest.fixture(scope="module")
def moving():
    return open_package(VALID / "moving")


@pytest.fixture(scope="module")
def cameras(moving):
    return draw_views(moving.manifest.region, 3, 5)


def test_dense_levels_fall_and_bytes_are_those_of_the_package(moving, cameras):
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


def test_inspect_shows_the_dense_ladder(moving, tmp_path, capsys):
    picture = tmp_path / "dense.png"
    assert manifest_main(["inspect", MOVING, "--ladder", "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "100 %" in out and "last before the cliff saves" in out and picture.stat().st_size > 10_000
    assert manifest_main(["inspect", MOVING, "--ladder", "--against", str(FOX)]) == 2
    assert "expected 4 frames, got 10" in capsys.readouterr().err


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
