"""Gaussians -> package files, top to bottom. T frames, N rows of a group, n rows of a level, P planes, C colours.

Two passes over the sequence: the canonical frames make the key streams; what those decode to is the space that the
states of all frames are differences to.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airgs_codec import __version__
from airgs_codec.analysis.importance import guess_channels
from airgs_codec.coding import escapes
from airgs_codec.coding.atlas import assemble, choose_layout, fit_atlas, picture_size, read_codes
from airgs_codec.coding.channels import Canonical, dequantise_key, state_channels
from airgs_codec.coding.quantize import from_codes, to_codes
from airgs_codec.coding.rangecoder import encode_columns
from airgs_codec.encoder.error_bounds import Sent
from airgs_codec.encoder.leave_out import StateNeeds, spare_key_planes
from airgs_codec.encoder.levels import assign_depths
from airgs_codec.encoder.plan import GroupPlan, Survey, plan_group, rank_updates
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.tables import Coded, escapes_path, group_tables, segment_tables, write_sidecars, write_streams
from airgs_codec.errors import SceneError
from airgs_codec.media.h264 import (
    KEY_QP,
    STATE_QP,
    ClosedGop,
    CodecSettings,
    check_stream,
    decode_pictures,
    encode_stream,
    key_codec,
    library_versions,
    qp_step,
    state_codec,
)
from airgs_codec.package import tables
from airgs_codec.package.layout import KEY, STATE
from airgs_codec.package.tables import STATIC, Atlas
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence


def encode_sequence(
    sequence: GaussianSequence,
    surveys: Sequence[Survey],
    cameras: Sequence[Camera],
    views: tables.Views,
    settings: EncodeSettings,
    folder: Path,
    attribution: str = "",
    notes: Sequence[str] = (),
    progress: Progress = silent,
) -> tables.Manifest:
    """Write every segment and sidecar of a package into `folder`; gives its tables, without measured quality.

    One survey a group, made with `cameras`, the training views; `notes` say what grouping found. Raises SceneError,
    CodecError, ConfigError.
    """
    scratch = folder / ".scratch"
    scratch.mkdir()
    plans = []
    for i, survey in enumerate(surveys):
        progress("order", i, len(surveys))
        plans.append(plan_group(sequence, survey, cameras, views.source == "given", settings))
    gains = qp_step(KEY_QP), qp_step(STATE_QP)
    timescale, ticks = _timing(sequence.fps)
    for plan in plans:
        _code_keys(plan, cameras, settings, gains[0])
    _number_keys(plans)
    key_streams = _encode_keys(plans, settings, sequence.fps, timescale, ticks, progress)
    spans = [_segment_spans(plan, settings.segment_s, sequence.fps) for plan in plans]
    moving: list[list[list[bool]]] = []  # group x segment x level: is there anything to fetch
    for g, plan in enumerate(plans):
        progress("states", g, len(plans))
        base = _decode_canonical(plan, key_streams, gains[0], settings)
        frames = sequence.load(range(plan.start, plan.stop)).frames
        moving.append(_code_states(plan, base, frames, cameras, spans[g], settings, gains[1], scratch, g))
    state_streams = _encode_states(plans, spans, moving, settings, sequence.fps, timescale, ticks, scratch, progress)
    files = write_streams(folder, key_streams, state_streams)
    files |= write_sidecars(folder, plans, spans, moving, scratch, len(settings.levels))
    for path in scratch.iterdir():
        path.unlink()
    scratch.rmdir()
    return tables.Manifest(
        version=tables.VERSION,
        generator=tables.Generator(__version__, library_versions(), settings.table()),
        attribution=attribution,
        repairs=[*notes, *(note for plan in plans for note in plan.notes)],
        frame_rate=[sequence.fps.numerator, sequence.fps.denominator],
        timescale=timescale,
        frames=len(sequence),
        sh_degree=sequence.sh_degree,
        key_gain=gains[0],
        state_gain=gains[1],
        views=views,
        qualities=[tables.KeyQuality(f"Q{i}", factor) for i, factor in enumerate(settings.key_factors)],
        levels=[
            tables.Level(f"L{j}", share, factor, settings.tiers_of(j))
            for j, (share, factor) in enumerate(settings.levels)
        ],
        key_pictures=[[coded.picture() for coded in row] for row in key_streams],
        state_pictures=[coded.picture() for coded in state_streams],
        groups=group_tables(plans),
        segments=segment_tables(spans, moving, state_streams),
        left_out=[entry for plan in plans for entry in plan.left_out],
        files=dict(sorted(files.items())),
    )


def _timing(fps: Fraction) -> tuple[int, int]:
    """Timescale (ticks a second, at least 1000) and ticks a frame, both whole."""
    factor = 1 if fps.numerator >= 1000 else 1000
    return fps.numerator * factor, fps.denominator * factor


def _code_keys(plan: GroupPlan, cameras: Sequence[Camera], settings: EncodeSettings, gain: float) -> None:
    """Atlases, samples and escapes of every tier and key quality."""
    steps = KEY.steps(plan.key_steps, len(plan.key_values) - KEY.colour_start)
    spare = spare_key_planes(plan, cameras, settings.scaled_price)
    for tier in range(len(settings.tiers)):
        atlases, samples, bases = [], [], []
        sent: list[Sent | None] = []
        rows = plan.tier_rows(tier)
        for factor in settings.key_factors:
            codes = to_codes(plan.key_values[None, :, rows], steps * factor, gain)
            atlas = _key_atlas(codes, gain / 2, spare) if codes.shape[2] else Atlas(0, [0] * len(steps), [], 0, 0)
            centred = (codes - np.array(atlas.centres, np.int32)[:, None])[:, atlas.planes]
            luma, base = escapes.split(centred)
            atlases.append(atlas)
            sent.append(Sent.of(plan.key_values[None, :, rows], atlas, steps * factor / gain) if atlas.rows else None)
            samples.append(luma[0])
            bases.append(base[0])
        plan.key_sent.append(sent)
        plan.key_atlases.append(atlases)
        plan.key_samples.append(samples)
        plan.key_bases.append(bases)


def _key_atlas(codes: NDArray[np.int32], limit: float, spare: NDArray[np.bool_]) -> Atlas:
    """As `fit_atlas`, but a key always has a picture: of its first channel, if all are constant."""
    atlas = fit_atlas(codes, limit, spare)
    if atlas.planes:
        return atlas
    return replace(atlas, planes=[0], plane_width=choose_layout(codes.shape[2], 1)[0], columns=1)


def _number_keys(plans: list[GroupPlan]) -> None:
    """Key units are numbered from 1 within their tier."""
    counts = [0] * len(plans[0].key_atlases)
    for plan in plans:
        for tier, atlases in enumerate(plan.key_atlases):
            counts[tier] += bool(atlases[0].rows)
            plan.numbers.append(counts[tier] if atlases[0].rows else 0)


def _encode_keys(
    plans: list[GroupPlan], settings: EncodeSettings, fps: Fraction, timescale: int, ticks: int, progress: Progress
) -> list[list[Coded]]:
    """Streams of tier x quality, with their picture sizes."""
    codec = key_codec(settings.preset)

    def encode(tier: int, quality: int) -> Coded:
        used = [plan for plan in plans if plan.key_atlases[tier][quality].rows]
        size = _common_size([plan.key_atlases[tier][quality] for plan in used])
        clips = [
            ClosedGop(
                assemble(plan.key_samples[tier][quality][None], plan.key_atlases[tier][quality], *size),
                plan.start * ticks,
                (plan.stop - plan.start) * ticks,
            )
            for plan in used
        ]
        return _encode_checked(lambda: clips, size, fps, timescale, codec) if used else Coded(None, size, [])

    pairs = [(t, q) for t in range(len(settings.tiers)) for q in range(len(settings.key_factors))]
    streams = _parallel(settings.jobs, [functools.partial(encode, *pair) for pair in pairs], "key pictures", progress)
    count = len(settings.key_factors)
    for plan in plans:
        for (tier, quality), coded in zip(pairs, streams, strict=True):
            number = plan.numbers[tier]
            plan.bound_key(tier, quality, [coded.differences[number - 1]] if number else [])
    return [streams[t * count : (t + 1) * count] for t in range(len(settings.tiers))]


def _encode_checked(
    clips: Callable[[], Iterable[ClosedGop]], size: tuple[int, int], fps: Fraction, timescale: int, codec: CodecSettings
) -> Coded:
    stream = encode_stream(clips(), size, fps, timescale, codec)
    return Coded(stream, size, check_stream(stream, clips(), codec))


def _common_size(atlases: list[Atlas]) -> tuple[int, int]:
    sizes = [picture_size(atlas) for atlas in atlases]
    size = (max((w for w, _ in sizes), default=0), max((h for _, h in sizes), default=0))
    if max(size) > tables.MAX_SIDE:
        raise SceneError(f"pictures of {size[0]}x{size[1]} exceed {tables.MAX_SIDE}: too many Gaussians for one atlas")
    return size


def _parallel(jobs: int, tasks: Sequence[Callable[[], Coded]], what: str, progress: Progress) -> list[Coded]:
    """Results in order; x264 releases the interpreter lock, so threads do."""
    with ThreadPoolExecutor(jobs) as pool:
        futures = [pool.submit(task) for task in tasks]
        results = []
        for done, future in enumerate(futures):
            progress(what, done, len(tasks))
            results.append(future.result())
    return results


def _decode_canonical(
    plan: GroupPlan,
    streams: list[list[Coded]],
    gain: float,
    settings: EncodeSettings,
) -> Canonical:
    """The canonical space as a viewer of key quality 0 has it."""
    channels = len(plan.key_values) - KEY.colour_start
    steps = KEY.steps(plan.key_steps, channels) * settings.key_factors[0]
    parts = []
    for tier, row in enumerate(streams):
        stream, atlas = row[0].stream, plan.key_atlases[tier][0]
        if stream is None or not atlas.rows:
            continue
        media = stream.media[plan.numbers[tier] - 1]
        picture = next(decode_pictures(stream.init, media, f"key tier {tier} of frames {plan.start}-{plan.stop - 1}"))
        parts.append(from_codes(read_codes(picture, atlas, plan.key_bases[tier][0]), steps, gain))
    transform = tables.unpack_matrix(plan.transform, channels)
    values = np.concatenate(parts, axis=1)
    depths = np.full(len(plan.codes), STATIC, np.uint8)
    return dequantise_key(values, plan.codes, plan.classes, depths, transform, plan.grid, plan.key_steps)


def _segment_spans(plan: GroupPlan, segment_s: float, fps: Fraction) -> list[tuple[int, int]]:
    """Balanced spans of at most `segment_s` seconds (at least one frame) that cover the group."""
    frames = plan.stop - plan.start
    most = max(1, int(Fraction(segment_s).limit_denominator(1000) * fps))
    count = -(-frames // most)
    bounds = [plan.start + i * frames // count for i in range(count + 1)]
    return list(itertools.pairwise(bounds))


def _samples_path(scratch: Path, group: int, level: int) -> Path:
    return scratch / f"samples-{group}-{level}.npy"


def _code_states(
    plan: GroupPlan,
    base: Canonical,
    frames: list[Gaussians],
    cameras: Sequence[Camera],
    spans: list[tuple[int, int]],
    settings: EncodeSettings,
    gain: float,
    scratch: Path,
    group: int,
) -> list[list[bool]]:
    """Depths, and for every level its atlas, samples and escapes (left in `scratch`).

    Gives segment x level: whether anything there differs from the canonical frame by more than half a step.
    """
    values = state_channels([frame.take(plan.rows) for frame in frames], base, plan.state_steps)
    steps = STATE.steps(plan.state_steps, base.colours.shape[1])
    states = values / steps[:, None]
    changes = states - states[plan.canonical - plan.start]
    score, moving = rank_updates(states, changes, plan, settings)
    level_tiers = [settings.tiers_of(j) for j in range(len(settings.levels))]
    plan.depths = assign_depths(score, moving, [share for share, _ in settings.levels], plan.tiers, level_tiers)
    plan.leave_out("updates", *_unsent(plan, states))
    needs = StateNeeds(plan, base, values, cameras, settings.scaled_price)
    spare, quiet = needs.spare_planes(), needs.spare_segments(spans)
    fetched = [[False] * len(settings.levels) for _ in spans]
    for level, (_, factor) in enumerate(settings.levels):
        rows = (plan.depths != STATIC) & (plan.depths >= level)
        if not rows.any():
            plan.levels.append(Atlas(0, [0] * len(steps), [], 0, 0))
            plan.level_sent.append(None)
            continue
        codes = to_codes(values[:, :, rows], steps * factor, gain)
        atlas = fit_atlas(codes, gain / 2, spare)
        plan.levels.append(atlas)
        plan.level_sent.append(Sent.of(values[:, :, rows], atlas, steps * factor / gain))
        if not atlas.planes:
            continue
        centred = (codes - np.array(atlas.centres, np.int32)[:, None])[:, atlas.planes]
        samples = np.empty(centred.shape, np.uint8)
        for s, (start, stop) in enumerate(spans):
            part = slice(start - plan.start, stop - plan.start)
            differs = bool((np.abs(changes[part][:, :, rows]) > factor / 2).any())
            fetched[s][level] = differs and not quiet[s]
            samples[part], bases = escapes.split(centred[part])
            escapes_path(scratch, group, level, s).write_bytes(encode_columns(escapes.columns(bases)))
        np.save(_samples_path(scratch, group, level), samples)
    return fetched


def _unsent(plan: GroupPlan, states: NDArray[np.float64]) -> tuple[int, float, float]:
    """How many rows are static, what that is expected to cost beyond coding them, and the bytes a frame saved."""
    still = plan.depths == STATIC
    sizes, errors = guess_channels(states[:, :, still], np.zeros(states.shape[1]), plan.weights()[:, still])
    return int(still.sum()), float(errors.sum()), float(sizes.sum()) / len(states)


def _encode_states(
    plans: list[GroupPlan],
    spans: list[list[tuple[int, int]]],
    fetched: list[list[list[bool]]],
    settings: EncodeSettings,
    fps: Fraction,
    timescale: int,
    ticks: int,
    scratch: Path,
    progress: Progress,
) -> list[Coded]:
    """One stream a level."""
    codec = state_codec(settings.preset)

    def encode(level: int) -> Coded:
        size = _common_size([plan.levels[level] for plan in plans if plan.levels[level].planes])
        if not any(row[level] for group in fetched for row in group):
            return Coded(None, (0, 0), [])
        clips = functools.partial(_state_clips, plans, spans, fetched, level, size, ticks, scratch)
        return _encode_checked(clips, size, fps, timescale, codec)

    tasks = [functools.partial(encode, level) for level in range(len(settings.levels))]
    streams = _parallel(settings.jobs, tasks, "state pictures", progress)
    for level, coded in enumerate(streams):
        differences = iter(coded.differences)
        for g, plan in enumerate(plans):
            plan.bound_level(level, [next(differences) for row in fetched[g] if row[level]])
    return streams


def _state_clips(
    plans: list[GroupPlan],
    spans: list[list[tuple[int, int]]],
    fetched: list[list[list[bool]]],
    level: int,
    size: tuple[int, int],
    ticks: int,
    scratch: Path,
) -> Iterator[ClosedGop]:
    for g, plan in enumerate(plans):
        for s, (start, stop) in enumerate(spans[g]):
            if fetched[g][s][level]:
                samples = np.load(_samples_path(scratch, g, level), mmap_mode="r")
                pictures = (
                    assemble(samples[t : t + 1], plan.levels[level], *size)[0]
                    for t in range(start - plan.start, stop - plan.start)
                )
                yield ClosedGop(pictures, start * ticks, ticks)
