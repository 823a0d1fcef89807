"""The quality of every rung of a finished package, measured once against the original frames.

A rung is a pruning level with a keyframe quality. Pictures are of frames evenly spread over the package, each from a
view of its own. The top rung is measured in as many as bound the standard error of its PSNR, others in as many of these
as bound that of their ratio to it, or keep it below half of the error of the top rung (a ratio estimator; Cochran,
Sampling Techniques, 1977, chapter 6): a view that is hard for one rung is hard for all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from airgs_codec.decoder.decode import decode_canonical, decode_segment
from airgs_codec.encoder.views import SceneViews
from airgs_codec.media.metrics import Difference, Picture, low_psnr, psnr
from airgs_codec.package.manifest import Groups, Manifest, rungs_of
from airgs_codec.package.package import Package
from airgs_codec.package.region import GUESSED
from airgs_codec.package.tables import RungQuality
from airgs_codec.render.backend import Renderer
from airgs_codec.render.compare import compare, draw_frames, in_order
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

FIRST = 8  # pictures of every rung, which tell how many more it needs
ERROR_DB = 0.15  # standard error of a PSNR that is aimed at

Rung = tuple[int, int]  # pruning level, keyframe quality


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What pictures of some segments have shown."""

    segments: list[int]  # of each picture, from 0
    differences: dict[Rung, list[Difference]]  # of the first pictures; the top rung, in all of them, stands first


def measure(
    package: Package, sequence: GaussianSequence, views: SceneViews, renderer: Renderer, most: int, segments: range
) -> Seen:
    """Measure the rungs of some segments in up to `most` pictures, against the original frames after repairs."""
    m, cameras = package.manifest, views.measuring(sequence)
    rungs = sorted(itertools.product(range(len(m.levels)), range(len(m.qualities))))
    start, stop = m.segments[segments[0]].start, m.segments[segments[-1]].stop
    bits = (most - 1).bit_length()  # places whose bits are reversed are spread over the frames, however few of them
    places = sorted(range(most), key=lambda place: f"{place:0{bits}b}"[::-1])
    frames = [start + int((place + 0.5) * (stop - start) / most) for place in places]
    pictures = [(frame, cameras[(segments[0] * most + i) % len(cameras)]) for i, frame in enumerate(frames)]
    top, first = rungs[0], min(most, FIRST)
    spaces = lru_cache(2 * len(m.qualities))(partial(decode_canonical, package))

    def decoded(rung: Rung, numbers: Sequence[int]) -> Iterator[Gaussians]:
        level, quality = rung
        for index, some in itertools.groupby(numbers, key=m.segment_at):
            group, start = m.group_of(index), m.segments[index].start
            rows = sum(tier.count for tier in m.groups[group].tiers[: m.levels[level].tiers])
            base = spaces(group, quality).take(slice(rows))
            yield from decode_segment(package, index, base, level, [number - start for number in some])

    def look(wanted: dict[Rung, range], compared: Callable[[Picture, Picture], Difference]) -> None:
        """Add to `found` how each rung looks in its `wanted` pictures; each original is drawn once."""
        order = sorted({i for some in wanted.values() for i in some}, key=lambda i: pictures[i][0])
        asked = [(i, rung) for i in order for rung, some in wanted.items() if i in some]
        numbers = sorted({pictures[i][0] for i in order})
        draw = draw_frames(in_order(numbers, _originals(m, sequence, numbers)), renderer)
        originals, shown = lru_cache(maxsize=1)(lambda i: draw(*pictures[i])), {}
        for rung, some in wanted.items():
            of_rung = sorted({pictures[i][0] for i in some})
            shown[rung] = draw_frames(in_order(of_rung, decoded(rung, of_rung)), renderer)
        results = compare(
            lambda number, _: originals(asked[number][0]),
            lambda number, _: shown[asked[number][1]](*pictures[asked[number][0]]),
            [(number, pictures[i][1]) for number, (i, _) in enumerate(asked)],
            compared,
        )
        of = dict(zip(asked, results, strict=True))
        for rung, some in wanted.items():
            found[rung] += [of[i, rung] for i in some]

    found: dict[Rung, list[Difference]] = {rung: [] for rung in rungs}
    look({rung: range(first) for rung in rungs}, Difference.of)
    known, aim = {}, 10 ** (ERROR_DB / 10) - 1
    for rung in rungs:
        spread = _standard_error(found[rung], () if rung == top else found[top])
        own = rung[1] == m.levels[rung[0]].quality  # others are what viewers have while they change
        count = max(first, min(most if own else first, math.ceil(first * (spread / aim) ** 2)))
        known[rung] = range(first, count)
        if rung == top:  # half of its error adds an eighth to it
            aim = max(aim, spread * math.sqrt(first / count) / 2)
    known[top] = range(first, max(some.stop for some in known.values()))
    if len(known[top]):
        look(known, _error_of)
    return Seen([m.segment_at(frame) for frame, _ in pictures[: len(found[top])]], found)


def _error_of(reference: Picture, shown: Picture) -> Difference:
    """Compare by the squared error alone, which takes a third of the time of all figures."""
    error = reference.mse(shown)
    return Difference(error, None, None, error == 0 and bool((reference.rgb == shown.rgb[0, 0]).all()))


def _standard_error(differences: Sequence[Difference], top: Sequence[Difference] = ()) -> float:
    """Return the relative standard error of a mean squared error; with `top`, of its ratio to that of the top rung."""
    errors, others = (np.array([one.mse for one in some]) for some in (differences, top))
    if len(errors) < 2 or not errors.any():
        return 0.0
    away = errors - errors.mean() * (others / others.mean() if others.any() else 1.0)
    return float(np.sqrt(np.square(away).sum() / (len(errors) - 1) / len(errors)) / errors.mean())


def _originals(m: Manifest, sequence: GaussianSequence, numbers: Sequence[int]) -> Iterator[Gaussians]:
    for _, some in itertools.groupby(numbers, key=lambda number: m.group_of(m.segment_at(number))):
        yield from sequence.load(some).frames


def with_quality(m: Manifest, seen: Sequence[Seen], newest: bool = False) -> Manifest:
    """Give a package the quality that pictures of its segments have shown; of its groups only the `newest`, or all.

    Pictures that show nothing tell nothing. Where views were guessed, the harder half of the pictures alone tells the
    PSNR: those from where the scene was filmed may be among the harder ones. A segment differs from the whole as its
    top rung does in its own pictures; one without pictures does not differ.
    """
    top = next(iter(seen[0].differences))
    places = [place for some in seen for place in some.segments]
    whole = [one for some in seen for one in some.differences[top]]
    clear = [one for one in whole if not one.blank] or whole
    errors = np.sort([one.mse for one in clear])
    guessed = m.region.source in GUESSED and errors.any()
    harder = errors[len(errors) // 2 :].mean() / errors.mean() if guessed else 1.0
    rungs, ratios = {}, {}
    for rung in seen[0].differences:
        pairs = [pair for some in seen for pair in zip(some.differences[rung], some.differences[top], strict=False)]
        clear_pairs = [pair for pair in pairs if not pair[0].blank] or pairs
        own, others = [one for one, _ in clear_pairs], [other for _, other in clear_pairs]
        mse, colour = (_share(_mean(own, name), _mean(others, name)) for name in ("mse", "delta_e"))
        error = math.hypot(_standard_error(clear), _standard_error(own, others) if rung != top else 0.0)
        ratios[rung] = mse, colour
        rungs[rung] = RungQuality(
            psnr=round(psnr(harder * mse * (errors.mean() or 1.0)), 2),
            error=round(10 * math.log10(1 + error), 3),
            low=round(low_psnr([one.mse for one in own]), 1),
            ssim=round(_mean(own, "ssim"), 4),
            delta_e=round(colour * (_mean(clear, "delta_e") or 1.0), 2),
            pictures=len(own),
        )
    measured = [[rungs[j, q] for j in range(len(m.levels))] for q in range(len(m.qualities))]
    tables, numbers = [], range(len(m.groups) - 1 if newest else 0, len(m.groups))
    for number in numbers:
        segments = []
        for index, segment in zip(m.segments_of(number), m.groups[number].segments, strict=True):
            own = [one for one, place in zip(whole, places, strict=True) if place == index and not one.blank] or clear
            own = own if any(one.delta_e is not None for one in own) else [*own, clear[0]]
            error, colour = harder * _mean(own, "mse"), _mean(own, "delta_e")
            levels = []
            for j, level in enumerate(segment.levels):
                of_rungs = [ratios[j, q] for q in range(len(m.qualities))]
                shown = [round(psnr(error * share), 2) for share, _ in of_rungs]
                levels.append(replace(level, psnr=shown, delta_e=[round(colour * share, 2) for _, share in of_rungs]))
            segments.append(replace(segment, levels=levels))
        tables.append(replace(m.groups[number], segments=segments))
    views = replace(m.views, measured=max(quality.pictures for quality in rungs.values()))
    if newest:
        m.groups.keep(numbers[0], tables[0])
    return replace(m, groups=m.groups if newest else Groups.of(tables), rungs=measured, views=views)


def say_useless(m: Manifest) -> Manifest:
    """Return a measured package whose decisions name rungs that show less than a cheaper one, beyond their error.

    Rungs are compared that share their keyframes or their level: a player may hold one of both and choose the other.
    """
    shown = list(zip(rungs_of(m, 0), itertools.chain.from_iterable(m.rungs), strict=True))
    useless = [
        f"{rung.name} shows {other.psnr - quality.psnr:.1f} dB less than {cheaper.name}, which takes fewer bytes"
        for rung, quality in shown
        for cheaper, other in shown
        if (cheaper.keyframe_quality == rung.keyframe_quality or cheaper.level == rung.level)
        and cheaper.bytes < rung.bytes
        and other.psnr > quality.psnr + math.hypot(quality.error, other.error)
    ]
    return replace(m, decisions=[*m.decisions, *useless])


def _mean(differences: Sequence[Difference], name: str) -> float:
    """Return the mean of a figure over the pictures for which it is known, of which there is one."""
    return float(np.mean([getattr(one, name) for one in differences if getattr(one, name) is not None]))


def _share(part: float, whole: float) -> float:
    """Return the ratio of two means; where there is no error that another could be a share of, the other itself."""
    return part / whole if whole else part
