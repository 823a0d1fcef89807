"""A plan is all that is chosen for a scene: it can be read, written and followed, and says why."""

import json
from dataclasses import replace

import pytest

from tests import faces
from tests.faces import ConfigError, EncodeSettings, GaussianSequence, Goal, Plan, decide
from tests.support.packages import SEEN
from tests.support.scenes import moving_frames, random_gaussians

SETTINGS = EncodeSettings(
    calibrate="none", measure_pictures=0, decide_pictures=2, preset="ultrafast", threads=1, group_frames=1, region=SEEN
)
STILL = [random_gaussians(60)] * 20


def test_runs_have_eight_groups_at_most_and_one_begins_where_gaussians_are_others():
    other = random_gaussians(50)
    for frames, begins in ((STILL, (0, 8, 16)), ([*STILL[:3], other, other], (0, 3))):
        sequence = GaussianSequence.from_arrays(frames)
        plan = decide(sequence, SETTINGS)
        assert plan.begins == begins and len(plan.groups) == len(frames)
        for run in plan.runs(sequence):  # a keyframe is chosen for what comes in its run
            assert all(frames.spans[-1][1] == run[-1].stop for frames in run)
    apart = decide(GaussianSequence.from_arrays(STILL[:3]), replace(SETTINGS, keyframes=faces.INTRA))
    assert apart.begins == (0, 1, 2)


def test_it_says_what_was_chosen_what_that_took_and_what_it_is_worth(tmp_path):
    sequence = GaussianSequence.from_arrays(
        moving_frames(200, 4), cameras=faces.orbit_views(STILL[0], count=4, size=64)
    )
    settings = replace(SETTINGS, calibrate="ladder", region=None, group_frames=4, measure_pictures=4)
    report = faces.encode(sequence, tmp_path / "out", settings, goal=Goal.psnr(40))
    stages = {stage.about: stage for stage in report.stages()}
    assert list(stages) == [
        "order of Gaussians", "views", "groups", "importance", "steps and pruning levels", "quality", "encoding",
        "measuring",
    ]  # fmt: skip
    assert all(stage.chosen and stage.seconds >= 0 for stage in stages.values())
    assert (
        stages["quality"].chosen.endswith("for PSNR 40") and "kB a frame" in stages["steps and pruning levels"].gained
    )
    assert report.plan.settings.calibrate == "none"  # nothing is left to choose
    again = decide(sequence, settings, goal=Goal.psnr(40))
    assert replace(again, choices=()) == replace(report.plan, choices=())


@pytest.mark.parametrize(("change", "words"), [
    (lambda p: "[]", "plan: "), (lambda p: "{", "plan: "),
    (lambda p: json.dumps({**json.loads(p), "run": "8"}), r"plan\.run: "),
    (lambda p: json.dumps({**json.loads(p), "more": 1}), "plan: .*more"),
    (lambda p: json.dumps({**json.loads(p), "groups": [[0, 1], [2, 3]]}), "groups: "),
    (lambda p: json.dumps({**json.loads(p), "begins": []}), "begins: "),
    (lambda p: json.dumps({**json.loads(p), "run": -1}), "run: "),
])  # fmt: skip
def test_what_is_no_plan_is_refused_in_one_line(change, words):
    plan = decide(GaussianSequence.from_arrays(STILL[:1]), SETTINGS).to_json()
    with pytest.raises(ConfigError, match=words) as caught:
        Plan.from_json(change(plan))
    assert "\n" not in str(caught.value)


def test_a_plan_of_another_sequence_or_with_a_goal_is_refused_and_leaves_nothing(tmp_path):
    plan, whole = (decide(GaussianSequence.from_arrays(STILL[:3]), replace(SETTINGS, group_frames=n)) for n in (1, 3))
    changed = [*STILL[:2], random_gaussians(50)]
    for followed, frames, more, words in (
        (plan, STILL[:2], {}, "at least 3 frames, got 2"),
        (plan, STILL[:3], {"goal": Goal.psnr(40)}, "goal: expected none"),
        (whole, changed, {}, "equal Gaussians in a group, got others from frame 2 on"),
    ):
        with pytest.raises(ConfigError, match=words):
            faces.encode(GaussianSequence.from_arrays(frames), tmp_path / "out", plan=followed, **more)
    assert list(tmp_path.iterdir()) == []
    longer = faces.encode(GaussianSequence.from_arrays(STILL[:5]), tmp_path / "out", plan=plan)
    assert len(longer.manifest.groups) == 5 and longer.plan.begins == (0,)
