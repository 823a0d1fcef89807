"""Decoded frames beside the original ones, as pictures: PSNR, SSIM and CIEDE2000 over views and frames.

Whatever was decoded is a stream of frames with a name: the rungs of a package, or the frames of another sequence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from airgs_codec._report import table
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.quality import QualitySums
from airgs_codec.errors import ConfigError
from airgs_codec.package.store import Package
from airgs_codec.package.tables import Quality
from airgs_codec.progress import Progress, silent
from airgs_codec.render import Camera, render
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence


def rung_streams(
    package: Package, frames: range, level: str | None = None, key_quality: str | None = None
) -> dict[str, Iterator[Gaussians]]:
    """These frames of every rung of a package, or of those of one level or key quality, decoded as they are asked for.

    Raises ConfigError for a level or key quality that the package does not have.
    """
    m = package.manifest
    levels = m.levels if level is None else [m.levels[m.level_index(level)]]
    qualities = m.qualities if key_quality is None else [m.qualities[m.quality_index(key_quality)]]
    return {f"{q.id}+{v.id}": _rung(package, frames, v.id, q.id) for q in qualities for v in levels}


def _rung(package: Package, frames: range, level: str, key_quality: str) -> Iterator[Gaussians]:
    for frame in decode_frames(package, frames[0], frames[-1] + 1, level=level, key_quality=key_quality):
        if frame.number in frames:
            yield frame.gaussians


def compare_streams(
    streams: Mapping[str, Iterator[Gaussians]],
    original: GaussianSequence,
    frames: range,
    cameras: Sequence[Camera],
    progress: Progress = silent,
) -> dict[str, Quality]:
    """Quality of every stream against the original after repairs; `streams` give `frames` and no others.

    Raises SceneError for a frame that cannot be read, FormatError for a package that cannot be decoded.
    """
    sums = {name: QualitySums() for name in streams}
    for done, number in enumerate(frames):
        progress("rendering", done, len(frames))
        reference = original.load([number]).frames[0]
        pictures = [render(reference, camera).rgb for camera in cameras]
        for name, stream in streams.items():
            shown = next(stream)
            for camera, picture in zip(cameras, pictures, strict=True):
                sums[name].add(render(shown, camera).rgb, picture)
    return {name: total.quality() for name, total in sums.items()}


def compared_views(cameras: Sequence[Camera], split: str | None) -> list[Camera]:
    """The cameras of a split; without one those that are held out (`test`), or all if none is. Raises ConfigError."""
    chosen = [camera for camera in cameras if camera.split == (split or "test")]
    if split and not chosen:
        found = ", ".join(sorted({camera.split for camera in cameras}))
        raise ConfigError(f"--split: expected one of {found}, got {split!r}")
    return chosen or list(cameras)


def format_comparison(qualities: Mapping[str, Quality]) -> str:
    """A line for each stream."""
    rows = [[name, f"{q.psnr:.2f}", f"{q.ssim:.4f}", f"{q.delta_e:.2f}"] for name, q in qualities.items()]
    return "\n".join(table(["decoded", "PSNR dB", "SSIM", "ΔE"], rows))
