"""Sequence -> package -> sequence: bounds on every attribute, levels, tiers, random access, leave-outs, atomicity."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.coding.channels import state_channels
from airgs_codec.coding.grid import cell_bits
from airgs_codec.decoder.states import state_units
from airgs_codec.encoder.plan import GroupLayout, keep_rows, lay_out
from airgs_codec.media.h264 import open_segment
from tests.faces import (
    KEY,
    STATE,
    ConfigError,
    EncodeSettings,
    Folder,
    FormatError,
    Gaussians,
    GroupSpan,
    LevelSettings,
    SceneError,
    StepSettings,
    ViewPlan,
    decode,
    decode_canonical,
    decode_frames,
    decode_key,
    decode_pictures,
    encode,
    mse,
    open_package,
    open_sequence,
    psnr,
    render,
    root_of,
    staged_package,
    survey_group,
    validate,
)
from tests.support.mutations import read_files
from tests.support.paths import FOX, VALID
from tests.support.regions import region
from tests.support.scenes import frozen, moving_frames, random_gaussians, write_sequence

FAST = EncodeSettings(calibrate="none", measure_pictures=0, preset="veryfast", threads=2)


def encoded(tmp_path, frames, settings=FAST):
    folder = write_sequence(tmp_path / "scene", frames)
    encode(open_sequence(folder), tmp_path / "out", settings)
    assert validate(tmp_path / "out") == []
    return open_package(tmp_path / "out")


def laid_out(sequence, index, group) -> GroupLayout:
    """The layout of a group of a package that was encoded with FAST."""
    views = ViewPlan.of(sequence, 24)
    survey = survey_group(sequence, GroupSpan(index, group.start, group.stop), views)
    loaded, settings = (
        sequence.load(range(group.start, group.stop)),
        replace(FAST, steps=FAST.steps.at_scale(views.scale)),
    )
    return lay_out(loaded, survey, keep_rows(loaded.frames, survey, FAST.row_error), settings, sequence.fps)


def same(a: Gaussians, b: Gaussians):
    """Equal but for the order in which BLAS sums colours."""
    for name in a.__slots__:
        np.testing.assert_allclose(
            getattr(a, name), getattr(b, name), rtol=0, atol=1e-5 if name.startswith("sh") else 0
        )


def opaque(g: Gaussians) -> Gaussians:
    return frozen(Gaussians(g.means, g.quaternions, g.log_scales, np.ones(len(g), np.float32), g.sh_dc, g.sh_rest))


@pytest.fixture(scope="module")
def fox(demo_package):
    return open_package(demo_package)


def test_the_embedded_scene_reaches_its_quality_and_size(fox):
    m = fox.manifest
    sequence = open_sequence(FOX)
    views = [c for c in sequence.cameras if c.held_out]
    errors = []
    for number in (0, 4, 7):
        shown = decode(fox, number)
        original = sequence.load([number]).frames[0]
        errors += [mse(render(shown, v).rgb, render(original, v).rgb) for v in views]
    assert psnr(float(np.mean(errors))) > 40.0
    assert m.bytes_of(m.rung_files(0, 0)) / m.frames < 16_000
    measured = [s.levels[0].psnr[0] for s in m.segments]
    assert psnr(float(np.mean(errors))) == pytest.approx(np.mean(measured), abs=1.0)


def test_quality_falls_and_bytes_fall_down_the_levels(fox):
    m = fox.manifest
    for s, segment in enumerate(m.segments):
        sizes = [m.bytes_of(m.state_files(s, j)) for j in range(len(m.levels))]
        assert sizes == sorted(sizes, reverse=True)
        shown = [got.psnr[level.quality] for got, level in zip(segment.levels, m.levels, strict=True)]
        assert shown == sorted(shown, reverse=True)


def test_the_whole_package_is_little_more_than_twice_its_top_rung(fox):
    m = fox.manifest
    whole = m.media_bytes()
    assert whole <= 2.2 * m.bytes_of(m.rung_files(0, 0))


def test_any_frame_alone_equals_the_frame_in_sequence(fox):
    in_sequence = {f.number: f.gaussians for f in decode_frames(fox, 0, 10, level=1, key_quality=1)}
    for number in (9, 0, 6):
        same(decode(fox, number, level=1, key_quality=1), in_sequence[number])


def test_the_first_tier_alone_gives_the_first_rows(fox):
    whole = [f.gaussians for f in decode_frames(fox, 5, 8)]
    core = [f.gaussians for f in decode_frames(fox, 5, 8, tiers=1)]
    count = fox.manifest.groups[1].tiers[0].count
    for a, b in zip(whole, core, strict=True):
        assert len(b) == count < len(a)
        same(a.take(np.arange(count)), b)


def test_state_codes_are_within_the_codecs_error_of_the_source(fox):
    """H.264 spreads an isolated jump over its block and may drop it: up to 3.3 steps were seen, 0.3 on average.

    A wrapped sample or a lost escape would be off by 20 steps (128 codes).
    """
    m = fox.manifest
    sequence = open_sequence(FOX)
    for g, group in enumerate(m.groups):
        layout = laid_out(sequence, g, group)
        frames = sequence.load(range(group.start, group.stop)).frames
        steps = STATE.steps(group.state_steps, m.colour_channels)
        for j, level in enumerate(m.levels):
            base = decode_canonical(fox, g, level.quality)
            values = state_channels([f.take(layout.rows) for f in frames], base, group.state_steps)
            rows = (base.depths >= j) & (base.depths != 255)
            for t, shown in enumerate(decode_pictures(fox, g, j, range(group.stop - group.start))):
                decoded = shown.values(slice(None), state_units(fox, g, j))
                error = (decoded - values[t][:, rows]) / (steps * level.factor)[:, None]
                drawn = frames[t].take(layout.rows).opacities()[rows] >= 1 / 255
                assert np.abs(error[:, drawn]).max() <= 5
                assert np.sqrt(np.mean(error**2)) <= 0.5


def test_key_codes_are_within_the_codecs_error_of_the_source(fox):
    m = fox.manifest
    sequence = open_sequence(FOX)
    group = m.groups[0]
    layout = laid_out(sequence, 0, group)
    values = layout.key_values()
    factors = [tier.factor for tier in group.tiers]
    assert factors[0] < 1 < factors[1]
    steps = np.outer(KEY.steps(group.key_steps, m.colour_channels), np.repeat(factors, [t.count for t in group.tiers]))
    for q, quality in enumerate(m.qualities):
        codes = np.concatenate([decode_key(fox, 0, t, q)[0] for t in range(2)], axis=1)
        error = codes / m.key_gain - values / (steps * quality.factor)
        assert np.abs(error).max() <= 2.5 and np.sqrt(np.mean(error**2)) <= 0.5


def test_canonical_means_are_within_half_a_cell(fox):
    sequence = open_sequence(FOX)
    for g, group in enumerate(fox.manifest.groups):
        layout = laid_out(sequence, g, group)
        for q, quality in enumerate(fox.manifest.qualities):
            error = np.abs(decode_canonical(fox, g, q).means - layout.key.means).max(axis=1)
            cells = layout.classes - layout.wider
            side = group.grid.step * 2.0 ** (layout.wider + cell_bits(cells, group.grid, quality.coarser))
            assert (error <= side / 2 * (1 + 1e-6)).all()
            assert len(np.unique(side)) > 2


@pytest.mark.parametrize(
    ("factors", "coarser"),
    [
        ((1.0,), (0,)),
        ((1.0, 1.4, 1.8, 3.7, 11.0), (0, 0, 1, 1, 3)),
        ((4.0, 1.0, 8.0), (0, 0, 1)),
        ((1e-6, 1e6), (0, 21)),
    ],
)
def test_cells_of_positions_grow_with_the_steps_of_a_key_quality(factors, coarser):
    assert replace(FAST, levels=(LevelSettings(0.0),), key_factors=factors).coarser == coarser


def test_a_coarser_key_quality_has_fewer_bytes_of_positions(fox):
    m = fox.manifest
    assert [quality.coarser for quality in m.qualities] == [0, 1]
    for g, group in enumerate(m.groups):
        for t, tier in enumerate(group.tiers):
            files = [open_segment(fox.read(m.key_files(g, t, q)[1]), "x")[0] or b"" for q in (0, 1)]
            fine, coarse = map(len, files)
            assert fine - coarse > 3 * tier.count / 8  # a bit for each axis, and escapes


def test_fine_steps_come_back_finely(tmp_path):
    frames = [opaque(f) for f in moving_frames(300, 4)]  # what is not drawn may hold any value
    steps = replace(StepSettings(), grid=0.00002)
    package = encoded(tmp_path, frames, replace(FAST, quality=0.05, steps=steps))
    for shown in decode_frames(package, 0, 4):
        nearest = np.linalg.norm(shown.gaussians.means[:, None] - frames[shown.number].means[None], axis=2)
        assert np.sort(nearest.min(axis=1))[-1] < 0.02


def test_a_row_that_jumps_far_and_back_is_escaped_not_clipped(tmp_path):
    frames = moving_frames(200, 5)
    means = frames[3].means.copy()
    means[11] += 500.0
    frames[3] = frozen(Gaussians(means, *(getattr(frames[3], n) for n in frames[3].__slots__[1:])))
    package = encoded(tmp_path, frames)
    steps = package.manifest.groups[0].state_steps.means
    shown = [f.gaussians for f in decode_frames(package, 0, 5)]
    far = int(np.argmax(shown[3].means[:, 0]))
    unit = decode_canonical(package, 0, 0).motion_units[far]
    assert np.abs(shown[3].means[far] - means[11]).max() <= 3 * steps * unit
    assert np.abs(shown[2].means[far] - frames[2].means[11]).max() <= 3 * steps * unit


def test_a_still_scene_has_no_state_at_all(tmp_path):
    package = encoded(tmp_path, moving_frames(50, 1) * 5)
    assert [level.file.bytes for level in package.manifest.segments[0].levels] == [0, 0, 0, 0]
    assert not any(path.startswith("state/") for path in package.manifest.files())
    frames = [f.gaussians for f in decode_frames(package, 0, 5)]
    same(frames[0], frames[4])


def test_a_segment_in_which_nothing_moves_has_no_files(tmp_path):
    still = moving_frames(60, 1)[0]
    there, back = (replace(still, means=still.means + np.float32(shift)) for shift in (0.1, -0.1))
    frames = [still] * 4 + [there] * 4 + [back] * 4  # their mean is the first part
    package = encoded(tmp_path, frames, replace(FAST, segment_s=4 / 30, levels=(LevelSettings(0.0),)))
    assert [package.manifest.state_files(s, 0) for s in range(3)] == [[], ["state/L0/2.m4s"], ["state/L0/3.m4s"]]
    assert not np.array_equal(decode(package, 11).means, decode(package, 0).means)


def test_constant_channels_have_no_plane(tmp_path):
    g = random_gaussians(80)
    flat = frozen(
        Gaussians(
            g.means, g.quaternions, g.log_scales, np.full(80, 3, np.float32), np.ones((80, 3), np.float32), g.sh_rest
        )
    )
    package = encoded(tmp_path, [flat])
    planes = package.manifest.groups[0].tiers[0].qualities[0].planes
    assert not {6, 7, 8, 9} & set(planes)
    shown = decode(package, 0)
    step = package.manifest.groups[0].key_steps
    assert np.abs(shown.opacities() - flat.opacities()[0]).max() <= step.opacity / 2 + 1e-6
    assert np.abs(shown.sh_dc - 1).max() <= np.sqrt(3) * step.sh_dc / 2 + 1e-3


@pytest.mark.parametrize("count", [1, 2, 255, 256, 257])
@pytest.mark.parametrize("degree", [0, 3])
def test_awkward_counts(tmp_path, count, degree):
    frames = moving_frames(count, 2, degree)
    package = encoded(tmp_path, frames, replace(FAST, keep_all=True))
    shown = decode(package, 1)
    assert len(shown) == count and shown.sh_degree == degree
    assert all(np.isfinite(getattr(shown, n)).all() for n in shown.__slots__)


def test_groups_of_different_counts_share_their_representations(tmp_path):
    package = encoded(tmp_path, moving_frames(300, 3) + moving_frames(700, 4), replace(FAST, keep_all=True))
    assert [g.count for g in package.manifest.groups] == [300, 700]
    assert [len(f.gaussians) for f in decode_frames(package, 0, 7)] == [300] * 3 + [700] * 4


def test_equal_input_gives_equal_packages(tmp_path):
    a = encoded(tmp_path / "a", moving_frames(90, 3), replace(FAST, threads=1))
    b = encoded(tmp_path / "b", moving_frames(90, 3), replace(FAST, threads=4))
    assert root_of(a.manifest) == root_of(b.manifest)


@pytest.mark.parametrize(
    "arguments", [{"start": 0, "stop": 99}, {"start": -1, "stop": 1}, {"level": 9}, {"key_quality": 7}]
)
def test_what_is_not_there_is_refused(fox, arguments):
    with pytest.raises(ConfigError):
        list(decode_frames(fox, **({"start": 0, "stop": 1} | arguments)))


@pytest.mark.parametrize(
    "settings",
    [
        {"levels": ()},
        {"calibrate": "none", "levels": (LevelSettings(0.5), LevelSettings(0.0))},
        {"calibrate": "none", "levels": (LevelSettings(0.0, -1.0),)},
        {"calibrate": "none", "levels": (LevelSettings(1.5),)},
        {"calibrate": "none", "levels": (LevelSettings(0.0, tiers=1),)},  # the top level needs all tiers
        {"calibrate": "none", "levels": (LevelSettings(0.0), LevelSettings(0.0, 1.5, 3))},
        {"calibrate": "none", "levels": (LevelSettings(0.0, 1.0, 0, 2),)},  # key qualities are 0 and 1
        {"calibrate": "none", "levels": (LevelSettings(0.0, 1.0, 0, 1), LevelSettings(0.0, 1.5))},
        {"quality": 0.0},
        {"segment_s": 0.0},
        {"group_frames": 0},
        {"tiers": (0.5, 0.4)},
        {"usage": "none"},
        {"preset": "warp"},
        {"update_rank": "none"},
        {"measure_pictures": -1},
        {"margin": 0.0, "region": region()},
        {"calibrate": "sometimes"},
        {"levels": (LevelSettings(0.0),)},  # calibration would replace them
        {"tiers": (0.5, 0.5)},
        {"threads": 0},
    ],
)
def test_settings_that_cannot_work_are_refused(settings):
    with pytest.raises(ConfigError):
        EncodeSettings(**settings)


def test_values_that_no_code_holds_are_refused_and_leave_the_old_package(tmp_path):
    good = encoded(tmp_path, moving_frames(20, 1))
    before = {p.name: p.read_bytes() for p in good.files.path.iterdir() if p.is_file()}
    frames = moving_frames(20, 4)
    frames[2] = replace(frames[2], sh_dc=np.where(np.arange(20)[:, None] == 12, np.float32(1e30), frames[2].sh_dc))
    folder = write_sequence(tmp_path / "wild", frames)
    with pytest.raises(SceneError, match=r"frame 2 \(.*ply\): sh_dc of row 12 is 1e\+30 .* codes"):
        encode(open_sequence(folder), good.files.path, FAST)
    assert {p.name: p.read_bytes() for p in good.files.path.iterdir() if p.is_file()} == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "scene", "wild"]  # no stage is left behind


@pytest.mark.parametrize("package", [False, True], ids=["alone", "beside a package"])
@pytest.mark.parametrize("foreign", ["thesis.tex", "manifest.mpd", "key/notes.txt", ".thesis.tex.part"])
def test_a_folder_with_other_files_is_never_replaced(tmp_path, package, foreign):
    out = tmp_path / "out"
    if package:
        shutil.copytree(VALID / "moving", out)
        foreign = foreign.replace("manifest.mpd", "other.mpd")
    (out / foreign).parent.mkdir(parents=True, exist_ok=True)
    (out / foreign).write_text("years of work")
    before = read_files(out)
    with pytest.raises(ConfigError, match="other files"), staged_package(Folder(out)):
        raise AssertionError("unreachable")
    assert read_files(out) == before


def test_a_package_with_unfinished_files_of_its_own_is_replaced(tmp_path):
    """A growing one whose writer was killed."""
    out = shutil.copytree(VALID / "moving", tmp_path / "out")
    (out / "group" / f".2.json.gz.{'0' * 16}.part").write_bytes(b"half")
    with staged_package(Folder(out)) as stage:
        (stage / "airgs.json").write_text("{}")
    assert [path.name for path in out.iterdir()] == ["airgs.json"]


def test_a_linked_file_is_refused(tmp_path):
    package = encoded(tmp_path, moving_frames(20, 1))
    path = package.files.path / "key/T0/1.bin"
    outside = tmp_path / "outside.bin"
    path.rename(outside)
    path.symlink_to(outside)
    with pytest.raises(FormatError, match="link"):
        decode(package, 0)
    assert "unsafe_path" in {f.reason for f in validate(package.files.path)}
