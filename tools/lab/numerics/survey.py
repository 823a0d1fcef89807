"""How far a claimed PSNR is off, against the seconds of looking: the law of the spread of pictures.

A claim is the PSNR of the pooled error of n pictures, each of a view and a frame of its own. Errors of single pictures
have a mean and a deviation sigma; the mean of n of them is off by sigma / sqrt(n), in dB by 10 / ln 10 times that over
the mean. Beside the law stand claims of n pictures that are drawn from all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from airgs_codec.media.metrics import psnr
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from tools.lab import seconds_of
from tools.lab.numerics.encode import ONE_RUNG
from tools.lab.numerics.rows import Bench, Place, Point, Row, Scene, picture_error, shown_frames

PICTURES, SEED, DRAWS = 192, 1000, 2000
COUNTS = (1, 2, 4, 8, 16, 32, 64)  # pictures of a claim
DRAWN, LAW = "drawn", "law of the spread"
OFF = "dB that the claim is off (root mean square)"
DB = 10 / math.log(10)


def measure(bench: Bench) -> Iterator[Point]:
    for scene in bench.scenes:
        package, count = bench.package(scene, ONE_RUNG, "one-rung"), 8 if bench.quick else PICTURES
        yield Point("claim", scene, {"pictures": count}, partial(claims, scene, package, count))


def claims(scene: Scene, package: Package, count: int) -> list[Row]:
    """A row of claims from so many pictures, and one of the law, for each of COUNTS."""
    frames, views = package.manifest.frames, draw_views(package.manifest.region, count, SEED)
    shown = shown_frames(package, range(frames))
    originals = [scene.sequence.load([n]).frames[0] for n in range(frames)]
    looked = [
        seconds_of(partial(picture_error, shown[i % frames], originals[i % frames], view))
        for i, view in enumerate(views)
    ]
    errors, rows = np.array([error for _, error in looked]), []
    spread, random = float(errors.std(ddof=1) / errors.mean()), np.random.default_rng(SEED)
    for n in COUNTS:
        drawn = errors[random.integers(0, count, (DRAWS, n))].mean(axis=1)
        off = np.abs([psnr(float(error)) - psnr(float(errors.mean())) for error in drawn])
        found = float(np.sqrt(np.mean(off**2))), float(np.percentile(off, 25)), float(np.percentile(off, 95))
        law = DB * spread / math.sqrt(n)
        took = [one.times(n) for one, _ in looked]
        rows.append(Row.by(Place("claims", scene.name, DRAWN, str(n)), took, found, OFF))
        rows.append(Row.by(Place("claims", scene.name, LAW, str(n)), took, (law, law, law), OFF))
    return rows


def answer(scene: str, rows: list[Row]) -> str:
    """What one picture is off, and how many take 0.1 dB at most in 19 of 20 claims."""
    one = next(row.error for row in rows if row.curve == LAW and row.setting == "1")
    drawn = next(row for row in rows if row.curve == DRAWN and row.setting == str(COUNTS[-1]))
    return (
        f"{scene}: a claim from n pictures is off by {one:.2f} dB / √n (standard error, of {drawn.runs} pictures), in "
        f"{COUNTS[-1]} drawn ones by {drawn.error:.3f}; at most 0.1 dB in 19 of 20 claims take "
        f"{math.ceil((1.96 * one / 0.1) ** 2)} pictures"
    )
