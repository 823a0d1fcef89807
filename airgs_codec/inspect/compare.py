"""Gaussians beside those that they should be, as pictures: PSNR, SSIM and CIEDE2000 over views and frames.

Either many streams of frames, such as the rungs of a package, against the original; or two scenes or packages, A and B,
of which A is the reference, with the worst picture and a typical one; or what cameras see of one scene, as a sheet.
H x W pixels, 8-bit RGB.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, brief
from airgs_codec._report import table
from airgs_codec.errors import ConfigError
from airgs_codec.inspect.sides import Side, before_both, comparable, is_package, shared_views, side_of, splits_of
from airgs_codec.media.image import contact_sheet, to_bytes
from airgs_codec.media.metrics import Difference, Picture, Quality, pool, psnr, squared_error
from airgs_codec.package.manifest import Manifest, pooled_quality
from airgs_codec.package.package import Package, open_package
from airgs_codec.progress import Progress, silent, told
from airgs_codec.render import Camera
from airgs_codec.render.compare import View, draw_frames, draw_once, draw_still, in_order
from airgs_codec.render.compare import compare as compare_views
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence

LABEL = 36  # pixels above each picture, for two lines
LEAST_WIDTH = 320  # pixels; smaller pictures are shown with larger pixels, so that labels have room
MOST_LETTERS = 44  # of a line
MOST_GAIN = 64
SHOWN = 0.999  # of the differences are not cut off

Measure = TypeVar("Measure")
Scene = Package | GaussianSequence


def compare_streams(
    streams: Mapping[str, Iterator[Gaussians]],
    original: GaussianSequence,
    views: Sequence[View],
    measure: Callable[[Picture, Picture], Measure],
    progress: Progress = silent,
) -> dict[str, list[Measure]]:
    """Return what `render.compare.compare` says of every stream against the original after repairs, view by view.

    Views of one frame follow each other; `streams` give their frames in that order and no others. Raises SceneError for
    a frame that cannot be read, FormatError for a package that cannot be decoded.
    """
    found: dict[str, list[Measure]] = {name: [] for name in streams}
    frames = [(number, list(seen)) for number, seen in itertools.groupby(views, key=lambda view: view[0])]
    for done, (number, seen) in enumerate(frames):
        progress("rendering", done, len(frames))
        reference = draw_once(draw_still(original.load([number]).frames[0]))
        for name, stream in streams.items():
            found[name] += compare_views(reference, draw_still(next(stream)), seen, measure)
    return found


def pool_splits(found: Mapping[str, Sequence[Difference]], views: Sequence[View]) -> dict[str, dict[str, Quality]]:
    """The quality of every stream in each split of the cameras; `found`: a difference for each of the views."""
    splits = {split: [view[1].split == split for view in views] for split in splits_of([view[1] for view in views])}
    expect_something(next(iter(found.values())))
    return {
        split: {name: pool(list(itertools.compress(errors, inside))) for name, errors in found.items()}
        for split, inside in splits.items()
    }


def expect_something(differences: Sequence[Difference]) -> int:
    """How many of some pictures show nothing. Raises ConfigError where none shows anything."""
    blank = sum(difference.blank for difference in differences)
    if blank == len(differences):
        raise ConfigError(f"views: expected some that show something, got {blank} pictures of nothing")
    return blank


def claimed_quality(m: Manifest, names: Iterable[str]) -> dict[str, Quality | None]:
    """Return what a package says of rungs named as in `rung_streams`; None where it was not measured."""
    pairs = {f"{q.id}+{v.id}": (j, i) for i, q in enumerate(m.qualities) for j, v in enumerate(m.levels)}
    return {name: pooled_quality(m, *pairs[name]) for name in names}


def format_comparison(splits: Mapping[str, Mapping[str, Quality | None]]) -> str:
    """A line for each stream, with columns for each split."""
    head = ["decoded", *(word for split in splits for word in (f"{split}: dB", "worst", "SSIM", "ΔE"))]
    names = next(iter(splits.values()))
    return "\n".join(table(head, [[name, *(c for s in splits.values() for c in _cells(s[name]))] for name in names]))


def _cells(q: Quality | None) -> list[str]:
    return [f"{q.psnr:.2f}", f"{q.worst:.1f}", f"{q.ssim:.4f}", f"{q.delta_e:.2f}"] if q else ["-"] * 4


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One picture: a frame as one camera sees it."""

    frame: int
    camera: Camera
    psnr: float  # dB, of B against A

    def __str__(self) -> str:
        return f"{self.psnr:.2f} dB, frame {self.frame}, camera {self.camera.name}"

    def to_json(self) -> dict[str, Any]:
        """The same as plain values, the camera by its name and position."""
        place = self.camera.position.tolist()
        return {"frame": self.frame, "camera": self.camera.name, "position": place, "psnr": self.psnr}


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How near B is to A over all pictures of some frames."""

    frames: tuple[int, ...]
    cameras: tuple[str, ...]  # their names
    gaussians: tuple[tuple[int, int], tuple[int, int]]  # of A and of B: fewest and most rows of a frame
    quality: Quality  # of pictures that show something
    pictures: tuple[Seen, ...]  # all, frame after frame
    blank: int = 0  # of them, which show nothing of either

    __repr__ = brief

    @property
    def ranked(self) -> list[Seen]:
        return sorted(self.pictures, key=lambda seen: seen.psnr)

    @property
    def worst(self) -> Seen:
        return self.ranked[0]

    @property
    def typical(self) -> Seen:
        """The picture whose error is the median."""
        return self.ranked[(len(self.pictures) - 1) // 2]

    @property
    def by_frame(self) -> list[float]:
        """PSNR of each frame in dB, of the mean squared error over its pictures."""
        errors = np.array([squared_error(seen.psnr) for seen in self.pictures]).reshape(len(self.frames), -1)
        return [psnr(float(error)) for error in errors.mean(axis=1)]


def compare(
    reference: Scene | str | Path,
    compared: Scene | str | Path,
    *,
    rung: str | None = None,
    frames: range | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | type = silent,
) -> Comparison:
    """How near a scene or package is to another, each open or at a path: what `airgs-manifest compare` tells.

    `rung`: key quality and level of a package, such as Q1+L2 (default: Q0+L0); of the compared one where both are.
    `frames` are by default all that both have; `cameras` those that `shared_views` finds, from the
    origin of the reference. `progress`: a function, or a class of bars such as tqdm.auto.tqdm. Raises ConfigError for a
    rung or frames that are not there and for frame rates that differ, and what reading either raises.
    """
    first, second = _opened("reference", reference), _opened("compared", compared)
    rungs = (None, rung) if isinstance(second, Package) else (rung, None)
    a, b = side_of(first, "reference", rungs[0]), side_of(second, "compared", rungs[1])
    a, b = comparable(a, b)
    both = range(min(a.frames, b.frames))
    numbers = both if frames is None else argument("frames", frames, range, "a range")
    if not numbers or numbers[0] not in both or numbers[-1] not in both:
        raise ConfigError(f"frames: expected some of {both}, got {numbers}")
    views = shared_views(a, b)[1] if cameras is None else list(cameras)
    return compare_two(a, b, numbers, before_both(a, b, views), told(progress))


def _opened(name: str, scene: Scene | str | Path) -> Scene:
    if isinstance(scene, Package):
        return scene
    if isinstance(scene, str | Path) and is_package(str(scene)):
        return open_package(scene)
    return argument(name, scene, GaussianSequence, "an open sequence or package, or the path of one", open_sequence)


def compare_two(a: Side, b: Side, frames: range, cameras: Sequence[Camera], progress: Progress = silent) -> Comparison:
    """B against A in the same frames and views, at least one of each.

    PSNR is of the mean squared error over all pictures (`media.metrics.PSNR_CAP` where there is none), SSIM and
    CIEDE2000 are means. Raises ConfigError where no picture shows anything, SceneError or FormatError for a frame that
    cannot be read.
    """
    views = [(number, camera) for number in frames for camera in cameras]
    rows: tuple[list[int], list[int]] = ([], [])
    first, second = (
        draw_frames(in_order(frames, _counted(side.read(frames), count)))
        for side, count in zip((a, b), rows, strict=True)
    )
    differences: list[Difference] = []
    for difference in compare_views(first, second, views, Difference.of):
        differences.append(difference)
        progress("comparing", len(differences), len(views))
    return Comparison(
        frames=tuple(frames),
        cameras=tuple(camera.name for camera in cameras),
        gaussians=((min(rows[0]), max(rows[0])), (min(rows[1]), max(rows[1]))),
        quality=pool(differences),
        pictures=tuple(Seen(*view, psnr(difference.mse)) for view, difference in zip(views, differences, strict=True)),
        blank=expect_something(differences),
    )


def _counted(frames: Iterator[Gaussians], rows: list[int]) -> Iterator[Gaussians]:
    """The frames, whose numbers of rows are added to `rows` as they are read."""
    for frame in frames:
        rows.append(len(frame))
        yield frame


def comparison_json(a: Side, b: Side, result: Comparison) -> dict[str, Any]:
    """The figures of both sides and of their comparison as plain values."""
    return {
        "reference": _side(a, result.gaussians[0]),
        "compared": _side(b, result.gaussians[1]),
        "frames": list(result.frames),
        "cameras": list(result.cameras),
        "blank": result.blank,
        "quality": dataclasses.asdict(result.quality),
        "worst": result.worst.to_json(),
        "typical": result.typical.to_json(),
    }


def _side(side: Side, gaussians: tuple[int, int]) -> dict[str, Any]:
    return {
        "name": side.name,
        "rung": side.rung,
        "frames": side.frames,
        "fps": side.fps and float(side.fps),
        "sh_degree": side.sh_degree,
        "gaussians": list(gaussians),
        "bytes_per_frame": side.bytes_per_frame,
        "claimed": side.claimed and dataclasses.asdict(side.claimed),
    }


def format_two(a: Side, b: Side, result: Comparison, views: str, notes: Iterable[str] = ()) -> str:
    """The same for people; `views` says what the cameras are, `notes` what was left out."""
    q, frames = result.quality, result.frames
    claim = f" (B's tables claim {b.claimed.psnr:.2f} dB)" if b.claimed else ""
    return "\n".join(
        [
            f"A, the reference: {_words(a, result.gaussians[0])}",
            f"B: {_words(b, result.gaussians[1])}, {b.bytes_per_frame / a.bytes_per_frame:.3g} times those of A",
            f"{len(frames)} frame{'s' * (len(frames) > 1)} ({frames[0]} to {frames[-1]}) in {views}",
            *(f"left out: {note}" for note in notes),
            *([f"not counted: {result.blank} pictures that show nothing"] if result.blank else []),
            f"PSNR    {q.psnr:.2f} dB pooled over pictures{claim}",
            f"SSIM    {q.ssim:.4f}",
            f"ΔE2000  {q.delta_e:.2f}",
            f"worst   {result.worst}",
            f"typical {result.typical}",
        ]
    )


def _words(side: Side, gaussians: tuple[int, int]) -> str:
    rows = f"{gaussians[0]:,}" if gaussians[0] == gaussians[1] else f"{gaussians[0]:,} to {gaussians[1]:,}"
    rate = f" at {float(side.fps):g} fps" if side.fps else ""
    name = f"{side.name} {side.rung}" if side.rung else side.name
    count = f"{side.frames} frame{'s' * (side.frames > 1)}{rate}"
    return f"{name}: {count}, {rows} Gaussians of SH degree {side.sh_degree}, {side.bytes_per_frame:,.0f} bytes a frame"


def side_by_side(a: Side, b: Side, seen: Seen) -> NDArray[np.uint8]:
    """(LABEL + H, 3 W, 3): A, B and their difference as one camera sees them, with labels above."""
    frames = range(seen.frame, seen.frame + 1)
    first, second = (draw_still(next(side.read(frames)))(seen.frame, seen.camera).rgb for side in (a, b))
    difference = np.abs(first - second)
    gain = difference_gain(difference)
    captions = [
        f"A, the reference: {a.label}\nframe {seen.frame}, camera {seen.camera.name}",
        f"B: {b.label}\n{seen.psnr:.2f} dB",
        f"difference x {gain}\nlargest {difference.max():.3f} of 1",
    ]
    pictures = [_with_room(to_bytes(picture)) for picture in (first, second, gain * difference)]
    return contact_sheet(pictures, ["\n".join(map(_shortened, text.split("\n"))) for text in captions], columns=3)


def difference_gain(difference: NDArray[np.float32]) -> int:
    """The power of 2, at most MOST_GAIN, that differences of [0, 1] are multiplied by to be seen."""
    large = float(np.quantile(difference, SHOWN))
    return MOST_GAIN if large * MOST_GAIN <= 1 else 2 ** max(0, math.floor(-math.log2(large)))


def _with_room(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture below a black band, its pixels as many times as wide as it needs."""
    times = math.ceil(LEAST_WIDTH / picture.shape[1])
    return np.pad(picture.repeat(times, axis=0).repeat(times, axis=1), ((LABEL, 0), (0, 0), (0, 0)))


def _shortened(text: str) -> str:
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 12]}..{text[-10:]}"
