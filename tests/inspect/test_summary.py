"""Figures of `airgs-manifest inspect`, worked out by hand on a manifest of known sizes."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from tests import faces
from tests.faces import LeftOut, describe_left_out, format_ladder, format_summary, summarise
from tests.support.manifests import in_groups, tiny_manifest
from tests.support.paths import FOX, VALID
from tests.support.regions import arc
from tests.support.scenes import write_sequence

MANIFESTS = 700  # bytes of airgs.json and manifest.mpd, say


def with_psnr(m, psnr):
    return replace(m, rungs=[[replace(quality, psnr=psnr) for quality in levels] for levels in m.rungs])


@pytest.mark.parametrize("claim", [None, -1e300, 1e300])
def test_what_is_not_measured_is_none_and_absurd_claims_are_still_numbers(claim):
    m = tiny_manifest(psnr=None) if claim is None else with_psnr(tiny_manifest(), claim)
    summary = summarise(m, MANIFESTS)
    written = json.loads(json.dumps(summary, allow_nan=False))
    for name in ("psnr", "error", "low", "ssim", "delta_e", "pictures"):
        assert (claim is None) == ({rung[name] for rung in written["rungs"]} == {None})
    assert format_summary(m, MANIFESTS)


def test_rates_and_bytes_of_levels_rungs_and_kinds_count_everything_a_viewer_fetches():
    m = tiny_manifest(groups=(10, 5))  # 1 s and 0.5 s; L0: 2000 B of media and 100 B of sidecar each
    level = summarise(m, MANIFESTS)["levels"][0]
    assert level["mean_bps"] == pytest.approx(2 * 16800 / 1.5)
    assert level["peak_bps"] == 33600
    assert level["bytes_per_frame"] == pytest.approx(4200 / 15)
    m = tiny_manifest()
    rungs = {(r["keyframe"], r["delta"]): r for r in summarise(m, MANIFESTS)["rungs"]}
    keyframes, delta = 2 * (3000 + 1000 + 2 * 100), 2 * (2000 + 100)
    assert rungs["Q0", "L0"]["bytes_per_frame"] * 20 == pytest.approx(keyframes + delta + MANIFESTS)
    assert rungs["Q1", "L2"]["bytes_per_frame"] * 20 == pytest.approx(3400 + 1200 + MANIFESTS)
    assert rungs["Q1", "L2"]["psnr"] == 32 and rungs["Q1", "L2"]["low"] == 30
    assert len(rungs) == 6
    m = tiny_manifest(groups=(3, 3))  # 2000 B of media hold 3 * 666 B of pictures
    kinds = summarise(m, MANIFESTS)["top_rung_bytes"]
    expected = {"keyframe pictures": 8000, "keyframe sidecars": 400, "delta pictures": 3996, "escapes and boxes": 204}
    assert kinds == expected | {"manifests": MANIFESTS}
    assert sum(kinds.values()) == m.bytes_of(m.rung_files(0, 0)) + MANIFESTS


def test_bits_of_a_gaussian_and_what_must_come_before_a_picture_are_told():
    summary = summarise(m := tiny_manifest(), MANIFESTS)
    assert summary["bits_per_gaussian"] == pytest.approx(8 * (2 * 6300 + MANIFESTS) / (20 * 20))
    top, lowest = summary["waits"]
    assert (top["rung"], top["seek_s"]) == ("Q0 + L0", pytest.approx(8e-6 * (100 + 6300 + 6 * 350) / 50))
    assert (lowest["rung"], lowest["seek_s"]) == ("Q1 + L2", pytest.approx(8e-6 * (100 + 2300 + 6 * 350) / 2))
    assert format_summary(m, MANIFESTS).count("round trips aside") == 2
    package = faces.open_package(VALID / "inter")
    offers = faces.Offers.of(package)
    tables, files = offers.sought(1, 0)
    assert tables == ("group/2.json.gz", "group/1.json.gz") and "keyframe/T0/Q0/1.m4s" in files
    first = offers.wire_bytes(("airgs.json", "group/1.json.gz", *package.manifest.rung_files(0, 0, [0])))
    waits = summarise(package.manifest, package.manifest_bytes)["waits"]
    assert waits[0]["first_s"] == pytest.approx(8e-6 * first / 50)


def test_rows_that_a_group_keeps_are_counted():
    m = faces.open_package(VALID / "inter").manifest
    assert [group["base"] for group in summarise(m, MANIFESTS)["groups"]] == [None, 1, 1]


def test_the_viewing_region_is_told_in_figures_and_words():
    region = arc(90, 3, 1.0)
    region.places[1] = replace(region.places[1], reach=0.25)
    m = replace(tiny_manifest(), region=region)
    record = json.loads(json.dumps(summarise(m, MANIFESTS)))["region"]
    assert (record["source"], record["places"], record["reach"]) == ("cameras", 3, [0.25, 1.0])
    assert record["distance"] == pytest.approx([3, 3]) and (record["turn"], record["near"]) == (10, 0.01)
    assert (record["width"], record["height"], record["fov_y"]) == (32, 24, 50)
    text = format_summary(m, MANIFESTS)
    assert "3 places with a reach of 0.25 to 1 units, 3 units from what is looked at" in text
    assert "views of 32x24 pixels, 50° high" in text and "nobody knows" not in text
    guess = replace(tiny_manifest(), region=replace(region, source="orbit"))
    assert "nobody knows from where" in format_summary(guess, MANIFESTS)


@pytest.mark.parametrize("m", [
    tiny_manifest(), tiny_manifest(psnr=None), with_psnr(tiny_manifest(), -1e300),
    tiny_manifest(groups=(1,), delta_bytes=(0,), psnr=[[100.0, 100.0]]),
], ids=["measured", "not measured", "absurd", "one still frame"])  # fmt: skip
def test_the_picture_is_drawn(m, tmp_path):
    faces.plot_ladder(m, MANIFESTS, tmp_path / "ladder.png")
    picture = faces.read_picture(tmp_path / "ladder.png")
    assert picture.shape[0] > 300 and picture.shape[1] > 1000
    assert picture.std() > 0.02  # not blank


def test_the_ladder_is_the_convex_hull():
    """Q0 + L1 costs more than Q1 + L0 and shows less; Q1 + L1 lies between two others, but above their line."""
    psnr = ((40.0, 36.0), (35.0, 32.5), (34.0, 32.0))
    m = tiny_manifest(keyframe_bytes=((9000, 1000), (1000, 500)), delta_bytes=(2000, 1900, 500), psnr=psnr)
    best = {(r["keyframe"], r["delta"]) for r in summarise(m, MANIFESTS)["rungs"] if r["best"]}
    assert best == {("Q0", "L0"), ("Q1", "L0"), ("Q1", "L2")}
    assert format_summary(m, MANIFESTS).count("*") == 1 + len(best)
    assert format_ladder(m, MANIFESTS).count(" + L") == len(best)
    unmeasured = format_ladder(tiny_manifest(psnr=None), MANIFESTS)
    assert unmeasured.count(" + L") == len(summarise(m, MANIFESTS)["rungs"]) and "not measured" in unmeasured
    assert not any(rung["best"] for rung in summarise(tiny_manifest(psnr=None), MANIFESTS)["rungs"])


def test_what_many_groups_leave_out_alike_is_one_line():
    m = tiny_manifest(groups=(10,) * 6)
    left_out = [[LeftOut("gaussians", 5 + g, 1e-5 * (g + 1), 100.0)] for g in range(6)]
    groups = [replace(group, left_out=left) for group, left in zip(m.groups, left_out, strict=True)]
    lines = describe_left_out(replace(m, groups=in_groups(groups)))
    assert lines[0] == "6 groups: 5-10 Gaussians: 42.2 dB by itself, at worst, 0.10 kB/frame saved"
    few = describe_left_out(replace(m, groups=in_groups([groups[0], *m.groups[1:]])))
    assert few[0] == "1 groups: 5 Gaussians: 50.0 dB by itself, at worst, 0.10 kB/frame saved"


def test_stiff_cases_are_counted_with_the_bound_that_holds(tmp_path):
    g = faces.read_ply(FOX / "000000.ply").take(slice(0, 600))
    scales = np.full((600, 3), -4.0, np.float32)
    scales[:50, 0] = 1.0  # 150 times as long as thin
    calm = replace(g, log_scales=scales, opacity_logits=np.where(np.arange(600) < 30, 9, 0).astype(np.float32))
    later = replace(calm, means=calm.means + np.where(np.arange(600) < 20, 3, 0)[:, None].astype(np.float32))
    settings = faces.EncodeSettings(keep_all=True, calibrate="none", measure_pictures=0, threads=2)
    faces.encode(write_sequence(tmp_path / "in", [calm, later]), tmp_path / "out", settings)
    package = faces.open_package(tmp_path / "out")
    found = faces.stiff_cases(package)
    assert [line.split(" are ")[0] for line in found] == [f"{n} of 600 Gaussians" for n in (50, 30, 20)]
    bound = float(re.search(r"opacity is right to ([\d.]+)", found[1])[1])
    measured = faces.measure_errors(package, faces.open_sequence(tmp_path / "in"))
    assert max(e.error for e in measured if e.attribute == "opacity" and e.where.endswith("0")) <= 1.05 * bound <= 0.1
