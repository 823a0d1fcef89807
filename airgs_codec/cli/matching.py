"""What is done before a scene is trained: cameras out of step are matched, those plainly wrong named."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from airgs_codec.cli.terminal import Bar, say, warn
from airgs_codec.trainer.data.between import in_step, read_offsets
from airgs_codec.trainer.data.multiview import MultiviewScene, frames_of
from airgs_codec.trainer.settings import AUTO, OFF

SHOWN = 4  # cameras that a line names, those furthest out of step


def match_cameras(
    scene: MultiviewScene, span: tuple[int, int | None], sync: str, known: Mapping[str, float] | None, *, quiet: bool
) -> MultiviewScene:
    """The frames [A, B) of a scene with its cameras in step, as --sync says, which is told.

    A warning names those that are plainly wrong.

    `known`: what the run that goes on has found, after which nothing is looked for again; None: it is a new one.
    Raises SceneError for a file of offsets, or a picture, that cannot be used.
    """
    from airgs_codec.trainer.data.doubt import find_doubtful, moving_alone  # what they import takes a second
    from airgs_codec.trainer.data.sync import REACH, Timing, find_timing

    given = None if sync in (AUTO, OFF) else read_offsets(Path(sync))
    if known is not None:
        return in_step(scene, known if sync == AUTO else given or {}, span)
    with closing(Bar(quiet)) as bar:
        timing = find_timing(scene, span, bar) if sync == AUTO else Timing()
        doubtful = find_doubtful(scene, timing.likeness, bar)
    matched = in_step(scene, timing.offsets if given is None else given, span)
    if timing.offsets and not quiet:
        say(offsets_line(timing.offsets, len(matched), len(range(*frames_of(scene, span)))))
    if alone := sorted({*moving_alone(timing.likeness)} - {*doubtful}):
        why = f"more than {REACH} frames out of step, or not its pose?"
        warn(f"warning: {', '.join(alone)}: what moves there is like in no other camera: {why}")
    if doubtful:
        names = ", ".join(doubtful)
        warn(f"warning: {names}: pictures do not fit the pose: those of another camera, mirrored or of another scene?")
    return matched


def offsets_line(offsets: Mapping[str, float], left: int, frames: int) -> str:
    """How far cameras are out of step, and how many frames all of them have."""
    order = sorted(offsets, key=lambda name: -abs(offsets[name]))
    words = [f"{name} is {abs(offsets[name]):g} frames {'late' if offsets[name] > 0 else 'early'}" for name in order]
    more = f" and {len(words) - SHOWN} more" if len(words) > SHOWN else ""
    return f"{', '.join(words[:SHOWN])}{more}: matched, all have {left} of {frames} frames; --sync off leaves it"
