"""Decides how a scene is encoded: the one place that looks at it and chooses before anything is encoded."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

from airgs_codec._arguments import argument
from airgs_codec.analysis.grouping import plan_groups
from airgs_codec.encoder.omit import omit_bands
from airgs_codec.encoder.order import Ordered, hold_frames, order_rows
from airgs_codec.encoder.plan import RUN, Choice, Plan
from airgs_codec.encoder.settings import DEFAULT_SETTINGS, EncodeSettings
from airgs_codec.encoder.steps import find_steps
from airgs_codec.encoder.survey import Survey
from airgs_codec.encoder.target import DELTA_E, Goal, search_quality, weigh_colours
from airgs_codec.encoder.views import choose_views
from airgs_codec.package.region import region_words
from airgs_codec.progress import Progress, Stopwatch, as_reporter, silent
from airgs_codec.render.backend import open_renderer
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

Surveys = dict[int, Survey]  # of groups by their number


def decide(
    sequence: GaussianSequence | str | Path,
    settings: EncodeSettings = DEFAULT_SETTINGS,
    *,
    goal: Goal | None = None,
    progress: Progress | type = silent,
) -> Plan:
    """Decide how `encode` encodes a sequence, open or at a path.

    `goal`: a quality factor is searched for that brings the top rung to this PSNR, colour difference or size;
    `settings.quality` is where the search starts. Raises SceneError for a scene that cannot be coded, ConfigError for a
    goal out of reach.
    """
    sequence = argument("sequence", sequence, GaussianSequence, "an open sequence or the path of one", open_sequence)
    with closing(hold_frames(sequence)) as held:
        return choose(order_rows(held, settings.rows, as_reporter(progress)), settings, goal, as_reporter(progress))[0]


def choose(
    ordered: Ordered, settings: EncodeSettings, goal: Goal | None, progress: Progress, run: int = RUN
) -> tuple[Plan, Surveys]:
    """Decide as `decide` does, and give what is known of groups that were looked at; `run` is as in `Plan`."""
    sequence, renderer, watch = ordered.sequence, open_renderer(settings.device), Stopwatch()
    in_order = f"{len(ordered.restored.matched)} frames were put in order"
    choices = [Choice("order of Gaussians", in_order, ordered.seconds)]
    progress("views", 0, 1)
    views, notes = choose_views(sequence, settings, renderer)
    progress("views", 1, 1)
    choices.append(Choice("views", region_words(views.region), watch.lap()))
    settings = replace(settings, steps=settings.steps.at_scale(views.scale))
    if goal and goal.metric == DELTA_E:
        settings = weigh_colours(settings, sequence, views, renderer)
    grouping = plan_groups(sequence, settings.group_frames)
    notes = (*notes, *sequence.notes, *ordered.notes, *grouping.notes)
    plan = Plan(settings, views, sequence.sh_degree, True, run, (), (), notes).with_groups(sequence, grouping.spans)
    longest = max(stop - start for start, stop in plan.groups)
    words = f"{len(plan.groups)} groups of up to {longest} frames in {len(plan.begins)} runs"
    choices.append(Choice("groups", words, watch.lap()))
    surveys: Surveys = {}
    if settings.calibrate != "none":
        progress("steps and pruning levels", 0, 1)
        firsts = [run[0] for run in plan.runs(sequence)]
        most = max(frames.stop - frames.start for frames in firsts)
        longest_firsts = [frames for frames in firsts if frames.stop - frames.start == most]
        sample = longest_firsts[len(longest_firsts) // 2]
        survey = Survey.of(sample, views, renderer)
        choices.append(Choice("importance", f"{len(survey.importance)} Gaussians ranked", watch.lap()))
        found = find_steps(sample, survey, views, settings)
        bands, words = omit_bands(sample, survey, found.settings)
        plan = replace(plan, settings=found.settings, sloped=found.sloped, sh_degree=bands)
        gained = f"about {found.saved / 1e3:.3g} kB a frame at equal error"
        choices.append(Choice("steps and pruning levels", plan.settings.words, watch.lap(), gained))
        if words:
            plan = replace(plan, notes=(*plan.notes, words))
            choices.append(Choice("SH bands", words))
        else:
            surveys[sample.number] = survey
        progress("steps and pruning levels", 1, 1)
    if goal:
        settings, trials = search_quality(plan, sequence, goal, surveys, renderer, progress)
        plan = replace(plan, settings=settings)
        tried = ", ".join(f"{factor:.3g}: {got:.4g}" for factor, got in trials)
        words = f"factor {settings.quality:.4g} for {goal.metric.name} {goal.value:g}"
        choices.append(Choice("quality", words, watch.lap(), f"trials {tried}"))
    return replace(plan, choices=tuple(choices)), surveys
