"""Sequence -> package -> sequence: bounds on every attribute, levels, tiers, random access, poster, atomicity."""

import io
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from airgs_codec.coding import channels, sidecar
from airgs_codec.encoder.publish import draw_poster
from airgs_codec.media.h264 import open_segment
from tests import faces
from tests.faces import ConfigError, EncodeSettings, LevelSettings, decode, decode_canonical, decode_frames, psnr
from tests.support.digests import decode_keyframe
from tests.support.mutations import read_files
from tests.support.packages import PACKAGES, laid_out
from tests.support.paths import FOX, VALID
from tests.support.regions import region
from tests.support.scenes import frozen, moving_frames, write_sequence

FAST = EncodeSettings(calibrate="none", measure_pictures=0, preset="veryfast", threads=2)


def same(a, b):
    for name in a.__slots__:
        atol = 1e-5 if name.startswith("sh") else 0
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=atol)


@pytest.fixture(scope="module")
def fox(demo_package):
    return faces.open_package(demo_package)


@pytest.fixture(scope="module")
def coded(fox):
    """Of each group of the fox: its number, its table, its frames, and how they were laid out."""
    sequence, found = faces.open_sequence(FOX), []
    for number, group in enumerate(fox.manifest.groups):
        frames = sequence.load(range(group.start, group.stop)).frames
        found.append((number, group, frames, laid_out(sequence, FAST, (group.start, group.stop))))
    return found


def test_the_embedded_scene_reaches_its_quality_and_size_and_both_fall_down_the_levels(fox):
    m, sequence, errors = fox.manifest, faces.open_sequence(FOX), []
    for number in (0, 4, 7):
        shown, original = decode(fox, number), sequence.load([number]).frames[0]
        for view in (camera for camera in sequence.cameras if camera.held_out):
            errors.append(faces.mse(faces.render(shown, view).rgb, faces.render(original, view).rgb))
    found = psnr(float(np.mean(errors)))
    assert found > 40.0
    assert found == pytest.approx(np.mean([s.levels[0].psnr[0] for s in m.segments]), abs=1.0)
    assert m.bytes_of(m.rung_files(0, 0)) / m.frames < 16_000
    assert m.media_bytes() <= 2.2 * m.bytes_of(m.rung_files(0, 0))
    for s, segment in enumerate(m.segments):
        sizes = [m.bytes_of(m.delta_files(s, j)) for j in range(len(m.levels))]
        assert sizes == sorted(sizes, reverse=True)
        shown = [got.psnr[level.quality] for got, level in zip(segment.levels, m.levels, strict=True)]
        assert shown == sorted(shown, reverse=True)


def test_any_frame_alone_and_the_first_tier_alone_are_parts_of_the_whole(fox):
    in_sequence = {f.number: f.gaussians for f in decode_frames(fox, 0, 10, level=1, keyframe_quality=1)}
    for number in (9, 0, 6):
        same(decode(fox, number, level=1, keyframe_quality=1), in_sequence[number])
    count = fox.manifest.groups[1].tiers[0].count
    for whole, core in zip(decode_frames(fox, 5, 8), decode_frames(fox, 5, 8, tiers=1), strict=True):
        assert len(core.gaussians) == count < len(whole.gaussians)
        same(whole.gaussians.take(np.arange(count)), core.gaussians)


def test_delta_codes_are_within_the_codecs_error_of_the_source(fox, coded):
    """H.264 spreads an isolated jump over its block and may drop it: up to 3.3 steps were seen, 0.3 on average.

    A wrapped sample or a lost escape would be off by 20 steps (128 codes).
    """
    m = fox.manifest
    for g, group, frames, layout in coded:
        shown_rows = [f.take(layout.rows) for f in frames]
        steps = faces.DELTA.steps(group.delta_steps, m.colour_channels)
        for j, level in enumerate(m.levels):
            base = decode_canonical(fox, g, level.quality)
            values = channels.delta_channels(shown_rows, base, group.delta_steps)
            rows = (base.depths >= j) & (base.depths != 255)
            for t, shown in enumerate(faces.decode_pictures(fox, g, j, range(group.stop - group.start))):
                error = shown.values(slice(None)) - values[t][:, rows]
                error /= (steps * level.factor)[:, None]
                drawn = shown_rows[t].opacities()[rows] >= 1 / 255
                assert np.abs(error[:, drawn]).max() <= 5
                assert np.sqrt(np.mean(error**2)) <= 0.5


def test_keyframe_codes_are_within_the_codecs_error_and_means_within_half_a_cell_of_the_source(fox, coded):
    """A coarser keyframe quality has fewer bytes of positions: a bit for each axis, and escapes."""
    m = fox.manifest
    assert [quality.coarser for quality in m.qualities] == [0, 1]
    for g, group, _, layout in coded:
        factors, counts = [tier.factor for tier in group.tiers], [tier.count for tier in group.tiers]
        assert factors[0] < 1 < factors[1]
        steps = np.outer(faces.KEYFRAME.steps(group.keyframe_steps, m.colour_channels), np.repeat(factors, counts))
        for q, quality in enumerate(m.qualities):
            if group.base is None:
                codes = np.concatenate([decode_keyframe(fox, g, t, q)[0] for t in range(2)], axis=1)
                error = codes / m.keyframe_gain - layout.keyframe_values() / (steps * quality.factor)
                assert np.abs(error).max() <= 2.5 and np.sqrt(np.mean(error**2)) <= 0.5
            error = np.abs(decode_canonical(fox, g, q).means - layout.keyframe.means).max(axis=1)
            cells = layout.classes - layout.wider
            side = group.grid.step * 2.0 ** (layout.wider + sidecar.cell_bits(cells, group.grid, quality.coarser))
            assert (error <= side / 2 * (1 + 1e-6)).all()
            assert len(np.unique(side)) > 2
        for t, count in enumerate(counts):
            fine, coarse = (len(open_segment(fox.read(m.keyframe_files(g, t, q)[1]), "x")[0] or b"") for q in (0, 1))
            assert fine - coarse > 3 * count / 8


@pytest.mark.parametrize(("factors", "coarser"), [
    ((1.0,), (0,)), ((1.0, 1.4, 1.8, 3.7, 11.0), (0, 0, 1, 1, 3)), ((4.0, 1.0, 8.0), (0, 0, 1)), ((1e-6, 1e6), (0, 21)),
])  # fmt: skip
def test_cells_of_positions_grow_with_the_steps_of_a_keyframe_quality(factors, coarser):
    assert replace(FAST, levels=(LevelSettings(0.0),), keyframe_factors=factors).coarser == coarser


def test_a_package_has_a_view_of_its_first_frame_from_where_viewers_begin(fox, monkeypatch):
    """A poster is worse and then smaller until it fits."""
    region, data, sequence = fox.manifest.region, fox.read(faces.POSTER_NAME), faces.open_sequence(FOX)
    assert 0 < len(data) <= 20_000
    with Image.open(io.BytesIO(data)) as opened:
        assert (opened.format, max(opened.size)) == ("JPEG", 640)
        poster = np.asarray(opened.convert("RGB"))
    camera = faces.with_pixels(faces.opening_view(region, fox.manifest.world), *poster.shape[1::-1])
    assert poster.shape[:2] == (360, 640)
    expected = faces.to_bytes(faces.CPU.render(sequence.load([0]).frames[0], camera).rgb)
    assert psnr(float(np.square((poster.astype(float) - expected) / 255).mean())) > 30  # what JPEG loses
    for most in (20_000, 5_000, 900):
        monkeypatch.setattr("airgs_codec.encoder.publish.MAX_POSTER_BYTES", most)
        data = draw_poster(sequence, 0, sequence.cameras[0], faces.CPU)
        with Image.open(io.BytesIO(data)) as opened:
            assert len(data) <= most and opened.size[0] == opened.size[1] <= 640


def test_fine_steps_come_back_finely(tmp_path):
    opaque = np.ones(300, np.float32)  # what is not drawn may hold any value
    frames = [frozen(replace(frame, opacity_logits=opaque)) for frame in moving_frames(300, 4)]
    fine = replace(FAST, quality=0.05, steps=replace(FAST.steps, grid=0.00002))
    faces.encode(write_sequence(tmp_path / "scene", frames), tmp_path / "out", fine)
    for shown in decode_frames(faces.open_package(tmp_path / "out"), 0, 4):
        nearest = np.linalg.norm(shown.gaussians.means[:, None] - frames[shown.number].means[None], axis=2)
        assert np.sort(nearest.min(axis=1))[-1] < 0.02


def test_what_does_not_move_has_no_deltas_and_constant_channels_have_no_plane(package_of):
    """Nothing moves in five frames; then something is where it was, on one side and on the other, a segment each."""
    few = faces.open_package(package_of("few"))
    m = few.manifest
    assert all(level.file.bytes == 0 for segment in m.groups[0].segments for level in segment.levels)
    assert [bool(m.delta_files(s, 0)) for s in range(8)] == [False] * 6 + [True] * 2
    assert m.delta_files(6, 0) == ["delta/L0/7.m4s"]
    same(decode(few, 0), decode(few, 4))
    assert not np.array_equal(decode(few, 7).means, decode(few, 5).means)
    flat, group, shown = PACKAGES["few"].groups()[2][0], m.groups[2], decode(few, 8)
    assert not {6, 7, 8, 9} & set(group.tiers[0].qualities[0].planes)
    assert np.abs(shown.opacities() - flat.opacities()[0]).max() <= group.keyframe_steps.opacity / 2 + 1e-6
    assert np.abs(shown.sh_dc - 1).max() <= np.sqrt(3) * group.keyframe_steps.sh_dc / 2 + 1e-3


def test_awkward_counts_share_their_representations(package_of):
    for name, start, degree in (("few", 9, 0), ("wide", 0, 3)):
        package = faces.open_package(package_of(name))
        assert faces.validate(package.files.path) == []
        shown = [frame.gaussians for frame in decode_frames(package, start, start + 10)]
        assert [len(g) for g in shown] == np.repeat([1, 2, 255, 256, 257], 2).tolist()
        assert {g.sh_degree for g in shown} == {degree}
        assert all(np.isfinite(getattr(g, name)).all() for g in shown for name in g.__slots__)


def bare(*levels, **more):
    return {"calibrate": "none", "levels": tuple(LevelSettings(*level) for level in levels), **more}


@pytest.mark.parametrize("settings", [
    bare((0.5,), (0.0,)), bare((0.0, -1.0)), bare((1.5,)), {"levels": ()},
    bare((0.0, 1.0, 1)), bare((0.0,), (0.0, 1.5, 3)),  # the top level needs all tiers, of which there are two
    bare((0.0, 1.0, 0, 2)), bare((0.0, 1.0, 0, 1), (0.0, 1.5)),  # keyframe qualities are 0 and 1
    {"levels": (LevelSettings(0.0),)}, {"tiers": (0.5, 0.5)},  # calibration would replace them
    {"tiers": (0.5, 0.4)}, {"quality": 0.0}, {"segment_s": 0.0}, {"group_frames": 0}, {"threads": 0},
    {"usage": "none"}, {"update_rank": "none"}, {"preset": "warp"}, {"calibrate": "sometimes"},
    {"measure_pictures": -1}, {"margin": 0.0, "region": region()},
], ids=str)  # fmt: skip
def test_settings_that_cannot_work_are_refused(settings):
    with pytest.raises(ConfigError):
        EncodeSettings(**settings)


def test_values_that_no_code_holds_are_refused_and_leave_the_old_package(tmp_path):
    out, frames = shutil.copytree(VALID / "moving", tmp_path / "out"), moving_frames(20, 4)
    before, row = read_files(out), np.arange(20)[:, None]
    frames[2] = replace(frames[2], sh_dc=np.where(row == 12, np.float32(1e30), frames[2].sh_dc))
    with pytest.raises(faces.SceneError, match=r"frame 2 \(.*ply\): sh_dc of row 12 is 1e\+30 .* codes"):
        faces.encode(write_sequence(tmp_path / "wild", frames), out, FAST)
    assert read_files(out) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "wild"]  # no stage is left behind


@pytest.mark.parametrize("foreign", ["thesis.tex", "manifest.mpd", "keyframe/notes.txt", ".thesis.tex.part"])
def test_a_folder_with_other_files_is_never_replaced_and_a_package_with_unfinished_ones_is(tmp_path, foreign):
    """Other files alone, and beside a package; a growing package whose writer was killed."""
    out = shutil.copytree(VALID / "moving", tmp_path / "out")
    for path in (tmp_path / "alone" / foreign, out / foreign.replace("manifest.mpd", "other.mpd")):
        folder = tmp_path / path.relative_to(tmp_path).parts[0]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("years of work")
        before = read_files(folder)
        with pytest.raises(ConfigError, match="other files"), faces.staged_package(faces.Folder(folder)):
            raise AssertionError("unreachable")
        assert read_files(folder) == before
    path.rename(out / "group" / f".2.json.gz.{'0' * 16}.part")
    with faces.staged_package(faces.Folder(out)) as stage:
        (stage / "airgs.json").write_text("{}")
    assert [path.name for path in out.iterdir()] == ["airgs.json"]
