"""One sentence for every panel, computed from its rows; '' where rows that it needs are missing."""

from __future__ import annotations

import math
from collections.abc import Callable

from airgs_codec.play.policies.named import ORACLES
from tools.precision import decode, encode, renderer, selector, survey, trainer
from tools.precision.rows import Row
from tools.precision.words import Rows, changed, each_scene, figure, one, pick, scenes, seconds, signed, times


def presets(rows: Rows) -> str:
    """The slowest preset beside the fastest, calibration, `--quick`."""
    return each_scene(rows, {scene: _presets(pick(rows, scene=scene)) for scene in scenes(rows)})


def _presets(rows: Rows) -> str:
    plain = pick(rows, curve=encode.PLAIN)
    if len(plain) < 2:
        return ""
    fast, slow = plain[0], plain[-1]
    parts = [
        f"`{slow.setting}` {changed(slow.bytes, fast.bytes, 'bytes')} of `{fast.setting}` at {encode.TARGET:g} dB and "
        f"{times(slow.seconds, fast.seconds)}"
    ]
    tuned = one(rows, curve=encode.CALIBRATED, setting=slow.setting)
    if tuned:
        more = tuned.seconds - slow.seconds
        parts.append(
            f"calibration {changed(tuned.bytes, slow.bytes, 'bytes')} at `{slow.setting}` and "
            f"{'adds' if more >= 0 else 'saves'} {seconds(abs(more))}"
        )
    quick = one(rows, curve=encode.PREVIEW)
    if quick:
        best = tuned or slow
        words = f"{changed(quick.bytes, best.bytes, 'bytes')} and {times(quick.seconds, best.seconds)}"
        parts.append(f"beside {'that' if tuned else f'`{slow.setting}`'} `--quick` {words}")
    return ", ".join(parts)


def claims(rows: Rows) -> str:
    """The largest number of pictures that every way has."""
    return each_scene(rows, {scene: _claims(pick(rows, scene=scene)) for scene in scenes(rows)})


def _claims(rows: Rows) -> str:
    curves = [pick(rows, curve=curve) for curve in (survey.APART, survey.ONE_VIEW, survey.ONE_FRAME)]
    common = set.intersection(*({row.setting for row in curve} for curve in curves))
    if not common:
        return ""
    count = max(common, key=int)
    apart, view, frame = (one(curve, setting=count) for curve in curves)
    assert apart and view and frame
    words = (
        f"{count} pictures are off by {apart.error:.2f} dB (median of {apart.runs} trials) where each has a view of "
        f"its own, {view.error:.2f} dB where all are from one view and {frame.error:.2f} dB where all are of one frame"
    )
    most = max(curves[0], key=lambda row: int(row.setting))
    if most.setting != count:
        words += (
            f", and {most.setting} pictures of their own views take {seconds(most.seconds)} for {most.error:.2f} dB"
        )
    return words


def deciding(rows: Rows) -> str:
    """The most pictures beside the fewest."""
    return each_scene(rows, {scene: _deciding(pick(rows, scene=scene)) for scene in scenes(rows)})


def _deciding(rows: Rows) -> str:
    if len(rows) < 2:
        return ""
    few, most = rows[0], rows[-1]
    return (
        f"surveying with {most.setting} deciding pictures a group instead of {few.setting} "
        f"{changed(most.bytes, few.bytes, 'bytes')} at {encode.TARGET:g} dB and takes {seconds(most.seconds)} "
        f"instead of {seconds(few.seconds)}"
    )


def rungs(rows: Rows) -> str:
    """The lowest level, the fewest tiers and the keys alone beside the top rung."""
    return each_scene(rows, {scene: _rungs(pick(rows, scene=scene)) for scene in scenes(rows)})


def _rungs(rows: Rows) -> str:
    levels = pick(rows, curve=decode.RUNGS)
    if len(levels) < 2:
        return ""
    top = levels[0]
    ways = [(levels[-1], f"level {levels[-1].setting}")]
    ways += [(row, f"the first key tier alone ({row.setting})") for row in pick(rows, curve=decode.TIERS)[:1]]
    ways += [(row, "a key without states") for row in pick(rows, curve=decode.KEYS)]
    parts = [
        f"{name} {times(row.seconds, top.seconds)} and is {figure(top.error - row.error)} dB below"
        for row, name in ways
    ]
    return f"the top rung decodes in {seconds(top.seconds)} a frame: {', '.join(parts)}"


def stages(rows: Rows) -> str:
    """The stage that takes longest."""
    said = {}
    for scene in scenes(rows):
        some = pick(rows, scene=scene)
        whole, longest = sum(row.seconds for row in some), max(some, key=lambda row: row.seconds)
        said[scene] = f"{longest.curve} takes {100 * longest.seconds / whole:.0f} % of {seconds(whole)} a frame"
    return each_scene(rows, said)


def precision(rows: Rows) -> str:
    """The renderer beside its definition, in the largest pictures."""
    return each_scene(rows, {scene: _precision(pick(rows, scene=scene)) for scene in scenes(rows)})


def _precision(rows: Rows) -> str:
    names = (renderer.SHIPPED, f"{renderer.DEFINITION}, float32", f"{renderer.DEFINITION}, float64")
    found = [pick(rows, curve=name)[-1:] for name in names]
    if not all(found):
        return ""
    tiles, single, exact = (some[0] for some in found)
    return (
        f"the renderer draws {tiles.setting} pixels in {seconds(tiles.seconds)} with a mean error of "
        f"{figure(tiles.error)} grey levels, {figure(exact.seconds / tiles.seconds)} times as fast as the definition "
        f"in float64, which errs by {figure(single.error)} in float32"
    )


def tiles(rows: Rows) -> str:
    """The tile size that the renderer has beside the fastest other one."""
    return each_scene(rows, {scene: _tiles(pick(rows, scene=scene)) for scene in scenes(rows)})


def _tiles(rows: Rows) -> str:
    own = one(rows, setting=str(renderer.TILE))
    others = [row for row in rows if row is not own]
    if own is None or not others:
        return ""
    best = min(others, key=lambda row: row.seconds)
    spread = max(abs(row.error - own.error) for row in others)
    words = (
        f"with tiles of {best.setting} pixels in place of {own.setting} a picture {times(best.seconds, own.seconds)}"
    )
    more = f" by more than {figure(spread)} grey levels" if spread > 0 else ""
    return f"{words}, and no size changes the error{more}"


def cuts(rows: Rows) -> str:
    """The coarsest cut-off beside the renderer's own."""
    return each_scene(rows, {scene: _cuts(pick(rows, scene=scene)) for scene in scenes(rows)})


def _cuts(rows: Rows) -> str:
    own = one(rows, setting=f"1/{renderer.CUT}")
    others = [row for row in rows if row is not own]
    if own is None or not others:
        return ""
    other = others[0]
    return (
        f"leaving out what is fainter than {other.setting} in place of {own.setting} "
        f"{times(other.seconds, own.seconds)} and errs by {figure(other.error)} grey levels"
    )


def first(rows: Rows) -> str:
    """What the last doubling of the iterations brings."""
    if len(rows) < 2:
        return ""
    before, last = rows[-2], rows[-1]
    return (
        f"{last.setting} iterations in place of {before.setting} change a first frame by "
        f"{signed(last.error - before.error)} dB, to {last.error:.1f} dB, in {seconds(last.seconds)} in place of "
        f"{seconds(before.seconds)}."
    )


def views(rows: Rows) -> str:
    """The best point with one view an iteration beside that with most."""
    curves = list(dict.fromkeys(row.curve for row in rows))
    if len(curves) < 2:
        return ""
    single, many = (pick(rows, curve=curve)[-1] for curve in (curves[0], curves[-1]))
    return (
        f"{single.setting} iterations of {single.curve.split()[0]} view reach {single.error:.1f} dB in "
        f"{seconds(single.seconds)}, {many.setting} of {many.curve.split()[0]} views {many.error:.1f} dB in "
        f"{seconds(many.seconds)}."
    )


def keyframe(rows: Rows) -> str:
    """When the warm start reaches what the longest fit from scratch does."""
    warm, scratch = pick(rows, curve=trainer.WARM_CURVE), pick(rows, curve=trainer.SCRATCH_CURVE)
    if not (warm and scratch):
        return ""
    wanted = scratch[-1]
    sooner = next((row for row in warm if row.error >= wanted.error), None)
    if sooner is None:
        best = max(warm, key=lambda row: row.error)
        return (
            f"From scratch a keyframe reaches {wanted.error:.1f} dB in {seconds(wanted.seconds)}, from the frame "
            f"before at most {best.error:.1f} dB, in {seconds(best.seconds)}."
        )
    return (
        f"From the frame before a keyframe has {sooner.error:.1f} dB after {seconds(sooner.seconds)}, from scratch "
        f"{wanted.error:.1f} dB after {seconds(wanted.seconds)}."
    )


def frame(rows: Rows) -> str:
    """The longest fit of every way."""
    ways = {row.curve: row for row in rows}  # the last one of each
    parts = [f"`{name}` reaches {row.error:.1f} dB in {seconds(row.seconds)}" for name, row in ways.items()]
    return f"With the most iterations {', '.join(parts)}." if parts else ""


def policies(rows: Rows) -> str:
    """The least regret without knowledge of the link, and with it."""
    blind = [row for row in rows if row.setting not in ORACLES]
    known = [row for row in rows if row.setting in ORACLES]
    if not blind:
        return ""
    best, quickest = min(blind, key=lambda row: row.error), min(blind, key=lambda row: row.seconds)
    words = f"`{best.setting}` has the least regret, {best.error:.2f} dB (median of the links), with {_choice(best)}"
    if quickest is not best:
        words += f", `{quickest.setting}` has {quickest.error:.2f} dB with {_choice(quickest)}"
    if known:
        oracle = min(known, key=lambda row: row.error)
        words += f", and `{oracle.setting}`, which knows the link, {oracle.error:.2f} dB with {_choice(oracle)}"
    return f"{words}."


def _choice(row: Row) -> str:
    return f"{seconds(row.seconds)} a choice"


def horizon(rows: Rows) -> str:
    """The longest horizon beside the shortest, for every way that has the same two."""
    curves = [pick(rows, curve=curve) for curve in (selector.MPC, selector.LP, selector.MILP)]
    ends = [(some[0], some[-1]) for some in curves if len(some) > 1]
    if not ends:
        return ""
    few, many = (row.setting for row in ends[0])
    parts = [
        f"`{near.curve}` goes from {near.error:.2f} to {far.error:.2f} dB of regret and from "
        f"{seconds(near.seconds)} to {seconds(far.seconds)} a choice"
        for near, far in ends
        if (near.setting, far.setting) == (few, many)
    ]
    return f"Looking {many} segments ahead in place of {few}, {', '.join(parts)}."


def levels(rows: Rows) -> str:
    """Few levels beside many, and the programme beside the search."""
    greedy, whole = pick(rows, curve=selector.DENSE_GREEDY), pick(rows, curve=selector.DENSE_MILP)
    if len(greedy) < 2 or len(whole) < 2:
        return ""
    few, many, programme = greedy[0], greedy[-1], whole[-1]
    same = "the same" if math.isclose(programme.error, many.error, abs_tol=5e-4) else f"{programme.error:.3f} dB"
    moves = "lower" if many.error < few.error else "raise"
    return (
        f"{many.setting} levels in place of {few.setting} {moves} the regret from {few.error:.2f} to {many.error:.3f} "
        f"dB; the integer programme has {same}, for {seconds(programme.seconds)} a frame in place of "
        f"{seconds(many.seconds)}."
    )


Conclusion = Callable[[Rows], str]
