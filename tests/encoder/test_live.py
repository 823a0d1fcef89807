"""A package grows with the frames of its sequence: whole at any time, and in the end as if encoded at once."""

from dataclasses import replace

import numpy as np
import pytest

from airgs_codec.encoder import live as module
from tests import faces
from tests.faces import INTRA, EncodeSettings, SceneError, follow, open_package, validate
from tests.support.packages import SEEN, TWO_LEVELS
from tests.support.scenes import moving_frames, random_gaussians, write_sequence

QUICK = {"calibrate": "none", "measure_pictures": 2, "decide_pictures": 4, "preset": "ultrafast", "threads": 1}
SETTINGS = EncodeSettings(levels=TWO_LEVELS, group_frames=3, region=SEEN, **QUICK)
FRAMES = moving_frames(150, 8)


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(module, "LOOK_S", 0.0)


def write_one_at_a_time(folder, frames):
    """`more` of `follow`: before every look the next frame is written."""
    waiting = list(enumerate(frames))
    folder.mkdir()

    def more(count):
        assert count == len(frames) - len(waiting)
        number, frame = waiting.pop(0)
        faces.write_ply(folder / f"{number:03d}.ply", frame)
        return bool(waiting)

    return more


def followed(tmp_path, frames, settings, **more):
    """What was published of frames that are there, and the package."""
    scene = write_sequence(tmp_path / "scene", frames) if frames else tmp_path / "scene"
    given = {"more": lambda count: False} | more
    published = list(follow(faces.GrowingFolder(scene), tmp_path / "grown", settings, **given))
    assert validate(tmp_path / "grown") == []
    return published, open_package(tmp_path / "grown")


def test_groups_are_published_as_their_frames_appear(tmp_path):
    """Their keyframes are differences, where the base has what they need."""
    scene, out, spans = tmp_path / "scene", tmp_path / "out", []
    more, whole = write_one_at_a_time(scene, FRAMES), replace(SETTINGS, keep_all=True)
    for published in follow(faces.GrowingFolder(scene), out, whole, more=more):
        m = open_package(out).manifest
        spans.append((published.group.start, published.group.stop))
        assert m.live and m.frames == published.group.stop and len(m.groups) == published.number
        assert validate(out) == []
        assert all(len(level.psnr) == 2 for segment in m.segments for level in segment.levels)
    assert spans == [(0, 3), (3, 6), (6, 8)] and [group.base for group in m.groups] == [None, 1, 1]
    assert not open_package(out).manifest.live and validate(out) == []
    assert {path.name for path in tmp_path.iterdir()} == {"scene", "out"}


@pytest.mark.parametrize("keyframes", [faces.INTER, INTRA])
def test_with_the_plan_of_the_whole_it_holds_what_encoding_at_once_does(tmp_path, keyframes):
    scene = write_sequence(tmp_path / "scene", FRAMES)
    settings = replace(SETTINGS, keyframes=keyframes)
    once = faces.encode(scene, tmp_path / "once", settings)
    assert [group.base for group in once.manifest.groups] == ([None, 1, 1] if keyframes == faces.INTER else [None] * 3)
    _, grown = followed(tmp_path, FRAMES, settings, plan=once.plan)
    for path in (path for group in range(3) for path in once.manifest.group_files(group)):
        assert once.manifest.entry(path) == grown.manifest.entry(path)
    with pytest.raises(faces.ConfigError, match="plan: expected a sequence of at least 8 frames, got 7"):
        followed(tmp_path / "short", FRAMES[:7], settings, plan=once.plan)


def test_a_base_has_rows_of_groups_before_it_if_these_have_the_same_rows(tmp_path):
    """Five rows come, then another scene begins, and goes on: these groups share no keyframe, but the last two one.

    Then ten of 140 rows are seen in every other group, ten others in the rest: the second base has both.
    """
    more, others = faces.join_rows([FRAMES[1], random_gaussians(5, seed=3)]), 6 * [random_gaussians(150, seed=5)]
    turns = []
    for t in range(12):
        logits = FRAMES[0].opacity_logits[:140].copy()
        logits[:20] = 4.0
        logits[slice(10, 20) if t // 3 % 2 else slice(10)] = -20.0
        turns.append(replace(FRAMES[0].take(np.arange(140)), opacity_logits=logits))
    _, grown = followed(tmp_path, [*FRAMES[:4], more, FRAMES[2], *others, *turns], SETTINGS)
    assert [group.base for group in grown.manifest.groups] == [None, None, None, 3, None, None, 6, 6]


def test_an_error_leaves_the_groups_that_were_whole_closes_the_package_and_without_a_frame_there_is_none(tmp_path):
    with pytest.raises(SceneError, match="at least one"):
        followed(tmp_path, [], SETTINGS)
    assert list(tmp_path.iterdir()) == []
    (write_sequence(tmp_path / "scene", FRAMES[:4]) / "999.ply").write_bytes(b"ply\n")
    with pytest.raises(SceneError, match=r"999\.ply"):
        followed(tmp_path, FRAMES[:4], SETTINGS)
    m = open_package(tmp_path / "grown").manifest
    assert not m.live and m.frames == 4 and validate(tmp_path / "grown") == []


def test_rows_that_lost_their_order_are_matched_inside_each_group_and_the_first_is_calibrated(tmp_path):
    frames = [g.take(np.random.default_rng(t).permutation(len(g))) for t, g in enumerate(FRAMES)]
    frames[7] = random_gaussians(150, seed=9)  # nothing of the scene
    settings, more = replace(SETTINGS, calibrate="steps", decide_pictures=2), tmp_path / "scene"
    published, grown = followed(tmp_path, [], settings, more=write_one_at_a_time(more, frames))
    assert [(p.group.start, p.group.stop) for p in published] == [(0, 3), (3, 6), (6, 7), (7, 8)]
    assert published[1].notes == ["frames 4-5: rows were out of order; matched again, 100.0% of them with confidence"]
    assert "frame 7: rows are not those of the frame before" in published[2].notes[0] and not published[3].notes
    assert grown.manifest.groups[2].delta_steps != settings.steps.delta
