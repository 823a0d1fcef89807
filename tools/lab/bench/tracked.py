"""What tracking makes of frames that know nothing of each other.

A sequence is disturbed, frame by frame and each frame in another way: rows in another order, places moved by a tenth of
their Gaussian's size, one row in twenty deleted and one in twenty split in two. Or it comes as it is (`--as-it-is`),
say as frames that were trained one by one. It is coded frame by frame and tracked, and both are compared with the
original or, where transforms.json names them, with pictures, from the held-out cameras, errors pooled over all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from airgs_codec import EncodeSettings, encode, open_package
from airgs_codec.decoder.decode import decode_frames
from airgs_codec.jobs.work import Work
from airgs_codec.media.metrics import low_psnr, mse, psnr
from airgs_codec.render import Camera, render
from airgs_codec.render.backend import open_renderer
from airgs_codec.scene.formats.ply import write_ply
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from airgs_codec.trainer.track import tracked
from tools.lab import Lab, Page, Row, Section, Table, seconds_of, setting
from tools.lab.rd.subject import Measured, read_truth

MOVED, GONE, SPLIT = 0.1, 0.05, 0.05  # of a Gaussian's size; shares of rows
APART, SMALLER = 0.3, 1.3  # halves of a split row: their distance, and by how much they are smaller
ALONE, TRACKED, GIVEN = "frame by frame", "tracked", "as given"
COLUMNS = {
    "coded": ("coded", ""), "kb": ("kB a frame", ".1f"), "psnr": ("PSNR, dB", ".1f"), "worst": ("worst 5 %", ".1f"),
    "seconds": ("CPU s a frame", ".1f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options(Measured):
    frames: int = setting(30, "frames, the first ones")
    as_it_is: bool = setting(False, "code it as it comes")


def run(options: Options, lab: Lab) -> Page:
    clean, cameras = options.open()
    clean = replace(clean, paths=clean.paths[: options.frames], headers=clean.headers[: options.frames])
    given = clean if options.as_it_is else disturbed(clean, lab.folder / "disturbed")
    look = looks(clean, cameras, options.views)
    rows: list[Row] = [{"coded": GIVEN, "kb": None, "seconds": None} | look(given.read)]
    for name in (ALONE, TRACKED):
        target = lab.folder / f"{name.replace(' ', '-')}.airgs"
        took, _ = seconds_of(lambda name=name, target=target: code(given, target, name))  # type: ignore[misc]
        m = (package := open_package(target)).manifest
        shown = {frame.number: frame.gaussians for frame in decode_frames(package, 0, m.frames)}
        kb = (m.bytes_of(m.rung_files(0, 0)) + package.manifest_bytes) / m.frames / 1e3
        rows.append({"coded": name, "kb": kb, "seconds": took.cpu / m.frames} | look(shown.__getitem__))
    name = options.sequence.resolve().name
    how = (
        f"{name}, {len(clean)} frames, {'as they come' if options.as_it_is else WAYS}; {len(cameras)} cameras; seconds "
        "are of the whole encode."
    )
    return Page([Section("", tables=[Table(f"tracked-{name}", rows, COLUMNS)])], how)


def code(given: GaussianSequence, target: Path, name: str) -> None:
    if name == ALONE:
        encode(given, target, EncodeSettings(group_frames=1))
        return
    with tracked(given, open_renderer(EncodeSettings().device), Work()) as moving:
        encode(moving, target)


WAYS = (
    f"rows in another order in each, places moved by {MOVED:g} of their Gaussian's size, {GONE:.0%} of rows deleted "
    f"and {SPLIT:.0%} split"
)


def looks(
    clean: GaussianSequence, cameras: Sequence[Camera], views: Path
) -> Callable[[Callable[[int], Gaussians]], Row]:
    """What measures frames, each given by its number, against pictures of the scene or of the clean sequence."""
    truth = read_truth(views, cameras, range(len(clean)))
    wanted = truth or {n: [render(clean.read(n), camera).rgb for camera in cameras] for n in range(len(clean))}

    def look(frame: Callable[[int], Gaussians]) -> Row:
        errors = [
            mse(render(shown, camera).rgb, picture)
            for n, pictures in wanted.items()
            for shown in (frame(n),)
            for camera, picture in zip(cameras, pictures, strict=True)
        ]
        return {"psnr": psnr(float(np.mean(errors))), "worst": low_psnr(errors)}

    return look


def disturbed(clean: GaussianSequence, folder: Path) -> GaussianSequence:
    folder.mkdir(exist_ok=True)
    for number in range(len(clean)):
        write_ply(folder / f"{number:06d}.ply", disturb(clean.read(number), np.random.default_rng(1000 + number)))
    return replace(open_sequence(folder, fps=clean.fps), cameras=clean.cameras)


def disturb(g: Gaussians, rng: np.random.Generator) -> Gaussians:
    g = replace(g, means=(g.means + MOVED * _sizes(g) * rng.normal(size=g.means.shape)).astype(np.float32))
    g = g.take(rng.random(len(g)) > GONE)
    split = rng.random(len(g)) < SPLIT
    part = g.take(split)
    way = rng.normal(size=part.means.shape)
    step = APART * _sizes(part) * way / np.linalg.norm(way, axis=1, keepdims=True)
    small = replace(part, log_scales=part.log_scales - np.float32(np.log(SMALLER)))
    halves = [replace(small, means=(part.means + sign * step).astype(np.float32)) for sign in (-1, 1)]
    whole = Gaussians.join([g.take(~split), *halves])
    return whole.take(rng.permutation(len(whole)))


def _sizes(g: Gaussians) -> np.ndarray:
    return np.exp(g.log_scales.mean(axis=1, keepdims=True))
