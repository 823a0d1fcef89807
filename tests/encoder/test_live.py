"""A package grows with the frames of its sequence: whole at any time, and in the end as if encoded at once."""

from dataclasses import fields, replace

import numpy as np
import pytest

from airgs_codec.encoder import live as module
from airgs_codec.encoder.live import follow
from airgs_codec.encoder.survey import join_surveys
from tests.faces import (
    APART,
    EncodeSettings,
    Gaussians,
    GrowingFolder,
    LevelSettings,
    SceneError,
    decode_frames,
    encode,
    join_rows,
    open_package,
    open_sequence,
    validate,
    write_ply,
)
from tests.support.regions import place, region
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

SETTINGS = EncodeSettings(
    calibrate="none",
    levels=(LevelSettings(0.0), LevelSettings(0.4, 2.0, quality=1)),
    group_frames=3,
    measure_pictures=2,
    decide_pictures=4,
    preset="ultrafast",
    threads=1,
    region=replace(region(place(0.0)), width=96, height=72),
)
FRAMES = moving_frames(150, 8)


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    """A look at the folder follows the one before at once."""
    monkeypatch.setattr(module, "POLL_S", 0.0)


def write_one_at_a_time(folder, frames):
    """`more` of `follow`: before every look the next frame is written."""
    waiting = list(enumerate(frames))

    def more(count):
        assert count == len(frames) - len(waiting)
        number, frame = waiting.pop(0)
        write_ply(folder / f"{number:03d}.ply", frame)
        return bool(waiting)

    return more


def test_groups_are_published_as_their_frames_appear(tmp_path):
    scene, out = tmp_path / "scene", tmp_path / "out"
    scene.mkdir()
    spans = []
    for published in follow(GrowingFolder(scene), out, SETTINGS, more=write_one_at_a_time(scene, FRAMES)):
        m = open_package(out).manifest
        spans.append((published.group.start, published.group.stop))
        assert m.live and m.frames == published.group.stop and len(m.groups) == published.number
        assert validate(out) == []
        assert all(len(level.psnr) == 2 for segment in m.segments for level in segment.levels)
    assert spans == [(0, 3), (3, 6), (6, 8)]
    assert not open_package(out).manifest.live and validate(out) == []
    assert {path.name for path in tmp_path.iterdir()} == {"scene", "out"}


def test_it_holds_what_encoding_at_once_would(tmp_path):
    scene = write_sequence(tmp_path / "scene", FRAMES)
    # A base that is written at once has rows for groups that follow; runs are cut evenly where their end is known.
    apart = replace(SETTINGS, keys=APART, group_frames=4)
    encode(open_sequence(scene), tmp_path / "once", apart)
    list(follow(GrowingFolder(scene), tmp_path / "grown", apart, more=lambda count: False))
    once, grown = (open_package(tmp_path / name) for name in ("once", "grown"))
    paths = [path for group in range(2) for path in once.manifest.group_files(group)]
    assert [once.manifest.entry(path) for path in paths] == [grown.manifest.entry(path) for path in paths]
    for level in (0, 1):
        pairs = zip(decode_frames(once, 0, 8, level=level), decode_frames(grown, 0, 8, level=level), strict=True)
        for one, other in pairs:
            for field in fields(Gaussians):
                pair = (getattr(frame.gaussians, field.name) for frame in (one, other))
                np.testing.assert_array_equal(*pair)


def test_keys_are_differences_where_the_base_has_what_they_need(tmp_path):
    scene = write_sequence(tmp_path / "scene", FRAMES)
    whole = replace(SETTINGS, keep_all=True)
    list(follow(GrowingFolder(scene), tmp_path / "grown", whole, more=lambda count: False))
    assert [group.keeps for group in open_package(tmp_path / "grown").manifest.groups] == [None, 1, 1]
    assert validate(tmp_path / "grown") == []


def test_a_base_has_rows_that_groups_before_it_needed(tmp_path):
    """Ten rows are seen in every other group, ten others in the rest: the second base has both."""
    frames = []
    for t, g in enumerate(12 * FRAMES[:1]):
        logits = g.opacity_logits.copy()
        logits[:20] = 4.0
        logits[slice(10, 20) if t // 3 % 2 else slice(10)] = -20.0
        frames.append(replace(g, opacity_logits=logits))
    scene = write_sequence(tmp_path / "scene", frames)
    list(follow(GrowingFolder(scene), tmp_path / "grown", SETTINGS, more=lambda count: False))
    assert [group.keeps for group in open_package(tmp_path / "grown").manifest.groups] == [None, None, 2, 2]
    assert validate(tmp_path / "grown") == []


def test_groups_with_other_rows_share_no_key(tmp_path, monkeypatch):
    """The second group has five rows more after its first frame, the third is another scene, and the fourth goes on."""
    shared = []
    monkeypatch.setattr(module, "join_surveys", lambda surveys: shared.append(len(surveys)) or join_surveys(surveys))
    more, others = join_rows([FRAMES[1], random_gaussians(5, seed=3)]), 6 * [random_gaussians(150, seed=5)]
    scene = write_sequence(tmp_path / "scene", [*FRAMES[:4], more, FRAMES[2], *others])
    list(follow(GrowingFolder(scene), tmp_path / "grown", SETTINGS, more=lambda count: False))
    assert [group.keeps for group in open_package(tmp_path / "grown").manifest.groups] == [None, None, None, 3]
    assert shared == [1] and validate(tmp_path / "grown") == []


def test_the_first_group_is_calibrated(tmp_path):
    scene = write_sequence(tmp_path / "scene", FRAMES)
    settings = replace(SETTINGS, calibrate="steps", decide_pictures=2)
    list(follow(GrowingFolder(scene), tmp_path / "grown", settings, more=lambda count: False))
    assert open_package(tmp_path / "grown").manifest.groups[2].state_steps != settings.steps.state
    assert validate(tmp_path / "grown") == []


def test_an_error_leaves_the_groups_that_were_whole_and_closes_the_package(tmp_path):
    scene = write_sequence(tmp_path / "scene", FRAMES[:4])
    (scene / "999.ply").write_bytes(b"ply\n")
    with pytest.raises(SceneError, match=r"999\.ply"):
        list(follow(GrowingFolder(scene), tmp_path / "out", SETTINGS, more=lambda count: False))
    m = open_package(tmp_path / "out").manifest
    assert not m.live and m.frames == 4 and validate(tmp_path / "out") == []


def test_without_a_frame_nothing_is_written(tmp_path):
    with pytest.raises(SceneError, match="at least one"):
        list(follow(GrowingFolder(tmp_path / "scene"), tmp_path / "out", SETTINGS, more=lambda count: False))
    assert list(tmp_path.iterdir()) == []


def test_rows_that_lost_their_order_are_matched_inside_each_group(tmp_path):
    scene = tmp_path / "scene"
    scene.mkdir()
    frames = [g.take(np.random.default_rng(t).permutation(len(g))) for t, g in enumerate(FRAMES)]
    frames[7] = random_gaussians(150, seed=9)  # nothing of the scene
    published = list(follow(GrowingFolder(scene), tmp_path / "out", SETTINGS, more=write_one_at_a_time(scene, frames)))
    assert [(p.group.start, p.group.stop) for p in published] == [(0, 3), (3, 6), (6, 7), (7, 8)]
    assert published[1].notes == ["frames 4-5: rows were out of order; matched again, 100.0% of them with confidence"]
    assert "frame 7: rows are not those of the frame before" in published[2].notes[0] and not published[3].notes
    assert validate(tmp_path / "out") == []
