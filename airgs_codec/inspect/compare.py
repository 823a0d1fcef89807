"""Decoded frames beside the original ones, as pictures: PSNR, SSIM and CIEDE2000 over views and frames.

Whatever was decoded is a stream of frames with a name, such as the rungs of a package. It is seen by the cameras of
several splits, one of which may be drawn from the viewing region of the package.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from airgs_codec._report import table
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.quality import QualitySums
from airgs_codec.errors import ConfigError
from airgs_codec.media.metrics import Reference
from airgs_codec.package.manifest import Manifest, Quality, pooled_quality
from airgs_codec.package.region import draw_views
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Region
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence

REGION = "region"  # the split of views that are drawn from the package's region


def rung_streams(
    package: Package, frames: range, level: str | None = None, key_quality: str | None = None
) -> dict[str, Iterator[Gaussians]]:
    """These frames of every rung of a package, or of those of one level or key quality, decoded as they are asked for.

    Raises ConfigError for a level or key quality that the package does not have.
    """
    m = package.manifest
    levels = m.levels if level is None else [m.levels[m.level_index(level)]]
    qualities = m.qualities if key_quality is None else [m.qualities[m.quality_index(key_quality)]]
    return {f"{q.id}+{v.id}": rung_frames(package, frames, v.id, q.id) for q in qualities for v in levels}


def rung_frames(package: Package, frames: range, level: str, key_quality: str) -> Iterator[Gaussians]:
    """These frames of one rung, at least one, decoded as they are asked for; `decode_frames` says what is raised."""
    for frame in decode_frames(package, frames[0], frames[-1] + 1, level=level, key_quality=key_quality):
        if frame.number in frames:
            yield frame.gaussians


def compare_streams(
    streams: Mapping[str, Iterator[Gaussians]],
    original: GaussianSequence,
    frames: range,
    cameras: Sequence[Camera],
    progress: Progress = silent,
) -> dict[str, dict[str, Quality]]:
    """Quality of every stream against the original after repairs, in each split of the cameras.

    `streams` give `frames` and no others. Raises SceneError for a frame that cannot be read, FormatError for a package
    that cannot be decoded.
    """
    sums = {split: {name: QualitySums() for name in streams} for split in splits_of(cameras)}
    for done, number in enumerate(frames):
        progress("rendering", done, len(frames))
        reference = original.load([number]).frames[0]
        pictures = [Reference.of(render(reference, camera).rgb) for camera in cameras]
        for name, stream in streams.items():
            shown = next(stream)
            for camera, picture in zip(cameras, pictures, strict=True):
                sums[camera.split][name].add(render(shown, camera).rgb, picture)
    return {split: {name: total.quality() for name, total in some.items()} for split, some in sums.items()}


def splits_of(cameras: Sequence[Camera]) -> dict[str, int]:
    """How many cameras each split has."""
    names = [camera.split for camera in cameras]
    return {name: names.count(name) for name in dict.fromkeys(names)}


def region_views(region: Region, count: int, seed: int) -> list[Camera]:
    """Views drawn from a region, as a split of their own."""
    return [replace(view, split=REGION) for view in draw_views(region, count, seed)]


def compared_views(cameras: Sequence[Camera], split: str | None) -> list[Camera]:
    """The cameras of a split; without one those of REGION and those held out (`test`), or all if none is.

    Raises ConfigError.
    """
    found = splits_of(cameras)
    if split is not None and split not in found:
        raise ConfigError(f"--split: expected one of {', '.join(sorted(found))}, got {split!r}")
    wanted = {split} if split else {REGION, "test"} if "test" in found else set(found)
    return [camera for camera in cameras if camera.split in wanted]


def claimed_quality(m: Manifest, names: Iterable[str]) -> dict[str, Quality | None]:
    """What a package says of rungs named as in `rung_streams`; None where it was not measured."""
    pairs = {f"{q.id}+{v.id}": (j, i) for i, q in enumerate(m.qualities) for j, v in enumerate(m.levels)}
    return {name: pooled_quality(m, *pairs[name]) for name in names}


def format_comparison(splits: Mapping[str, Mapping[str, Quality | None]]) -> str:
    """A line for each stream, with columns for each split."""
    head = ["decoded", *(word for split in splits for word in (f"{split}: dB", "worst", "SSIM", "ΔE"))]
    names = next(iter(splits.values()))
    return "\n".join(table(head, [[name, *(c for s in splits.values() for c in _cells(s[name]))] for name in names]))


def _cells(q: Quality | None) -> list[str]:
    return [f"{q.psnr:.2f}", f"{q.worst:.2f}", f"{q.ssim:.4f}", f"{q.delta_e:.2f}"] if q else ["-"] * 4
