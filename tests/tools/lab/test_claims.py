"""The benchmark of claims: what it measures is what a viewer sees, and it says which claims fail."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.inspect.compare import compare_streams
from airgs_codec.inspect.sides import rung_streams
from airgs_codec.media.metrics import Picture, psnr
from airgs_codec.package.package import open_package
from airgs_codec.package.region import draw_views
from airgs_codec.scene.camera import resized
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import FOX
from tests.support.temporal import write_temporal
from tools.lab.bench.claims import Bench, Measured, Options, Row, is_beaten, measure, package_row, run, verdict
from tools.lab.command import Lab

FOUND = Measured(40.0, 35.0)


def row(kilobytes, found, claimed=40.0, ladder=True):
    return Row("fox", "40", f"{kilobytes:g}", kilobytes, 0.5, claimed, 33.0, replace(FOUND, mean=found), ladder)


def test_it_measures_what_the_comparison_does(demo_package):
    package, sequence = open_package(demo_package), open_sequence(FOX)
    cameras = [resized(camera, 0.2) for camera in draw_views(package.manifest.region, 2, seed=3)]
    found = measure(package, sequence, cameras[:1], pictures=2)
    frames = range(2, 10, 5)
    views = [(number, cameras[0]) for number in frames]
    compared = compare_streams(rung_streams(package, frames), sequence, views, Picture.mse)
    assert {name: m.mean for name, m in found.items()} == {n: round(psnr(np.mean(e)), 3) for n, e in compared.items()}
    assert all(m.worst < m.mean for m in found.values())


def test_cameras_take_turns_with_frames(demo_package):
    package, sequence = open_package(demo_package), open_sequence(FOX)
    near, far = (resized(camera, 0.2) for camera in draw_views(package.manifest.region, 2, seed=3))
    both = measure(package, sequence, [near, far], pictures=20)
    alone = [measure(package, sequence, [camera], pictures=10) for camera in (near, far)]
    for name, found in both.items():
        errors = [10 ** (-one[name].mean / 10) for one in alone]
        assert found.mean == pytest.approx(psnr(sum(errors) / 2), abs=0.002)
        assert found.worst == min(one[name].worst for one in alone)


def test_the_verdict_names_the_largest_errors_and_what_is_beaten():
    rows = [row(4.0, 39.0), row(3.0, 39.5, 39.6), row(2.0, 35.0, 35.5, ladder=False), row(1.0, 36.0, 36.0)]
    assert [is_beaten(r, rows) for r in rows] == [True, False, True, False]
    assert verdict(rows) == (
        "Of 1 top rungs 0 are found within 0.5 dB of their claims, all -1.00 to -1.00 dB from them; the worst picture "
        "found is at most 0.0 dB below the worst one claimed; rungs of ladders are off by -1.00 dB at most; a cheaper "
        "rung beats fox 40: 4."
    )
    good = [replace(row(4.0, 40.2), target="36", claimed_worst=37.5), row(1.0, 36.0, 35.8)]
    assert verdict(good).startswith("Of 2 top rungs 2 are found within 0.5 dB of their claims, all +0.20")
    assert "at most 2.5 dB below" in verdict(good) and verdict(good).endswith(
        "no rung of a ladder is beaten by a cheaper one."
    )
    shown = package_row(rows)
    assert (shown["low_kilobytes"], shown["low_measured"], shown["off"]) == (1.0, 36.0, -1.0)
    assert verdict([]) == "No package could be made."


def test_it_goes_on_after_a_target_out_of_reach(tmp_path, capsys):
    scene = write_temporal(tmp_path / "clip", count=120, frames=3, size=24)
    options = Options(
        (str(scene),),
        targets=("99.9", "default"),
        pictures=2,
        settings={"margin": 0.1, "preset": "ultrafast", "threads": 1},
    )
    made = run(options, Lab.at(tmp_path / "out"))
    assert "clip 99.9: target: 99.9 PSNR is out of reach" in capsys.readouterr().err
    assert "Of 1 top rungs" in made.sections[0].answer
    top = made.data[0].rows[0]
    manifest = open_package(tmp_path / "out" / "clip-default.airgs").manifest
    assert top["claimed"] == pytest.approx(manifest.segments[0].levels[0].psnr[0], abs=1e-3)
    assert top["claimed_worst"] == manifest.segments[0].levels[0].worst[0]
    ladder = [row for row in made.data[1].rows if row["ladder"]]
    assert top["off"] == max((row["measured"] - row["claimed"] for row in ladder), key=abs)


def test_a_region_without_other_views_needs_cameras(demo_package):
    package = open_package(demo_package)
    region = package.manifest.region
    point = replace(region, turn=0.0, places=[replace(place, reach=0.0) for place in region.places])
    bench = Bench(EncodeSettings(), 3, 1000, (), demo_package)
    assert len(bench.looks(package)) == 3
    with pytest.raises(ConfigError, match="--held-views"):
        bench.looks(replace(package, manifest=replace(package.manifest, region=point)))


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(SceneError, match="nowhere"):
        run(Options(("nowhere",)), Lab.at(tmp_path))
    with pytest.raises(ConfigError, match="--targets: expected dB or default, got much"):
        Options(("nowhere",), targets=("much",))
