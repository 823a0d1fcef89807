"""Do packages have the quality that they claim? Every rung measured again where no decision of the encoder looked.

Each scene is encoded with `--target-psnr` for each target. For every rung the PSNR that the package claims stands
beside that of pictures from views drawn anew from its viewing region, one for each picture, which take turns with the
frames, errors pooled as in a package; and the worst picture that it claims beside the worst one found. Errors are
heavy-tailed: one view close to a large Gaussian may outweigh a hundred. The packages stay in the
folder.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from airgs_codec import encode, open_package, open_sequence
from airgs_codec.encoder.search import PSNR, Goal
from airgs_codec.errors import AirgsError
from airgs_codec.inspect.compare import rung_streams
from airgs_codec.inspect.summary import rung_rows
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.package.package import Package
from airgs_codec.package.region import draw_views
from airgs_codec.render import Camera, render
from airgs_codec.scene.sequence import GaussianSequence
from tools.lab import Lab, Page, Section, Table, required, setting
from tools.lab import Row as PlainRow
from tools.lab.made import name_of

CLOSE_DB = 0.5  # from a claim, where it holds
SEED = 1000  # of the views that measure
DEFAULT = "default"  # in place of a target: the encoder's own quality
COLUMNS = {
    "scene": ("scene", ""), "target": ("target, dB", ""), "kilobytes": ("top rung, kB a frame", ".1f"),
    "claimed": ("claimed, dB", ".1f"), "measured": ("found", ".1f"), "claimed_worst": ("worst picture claimed", ".1f"),
    "worst": ("found", ".1f"), "low_kilobytes": ("lowest rung, kB a frame", ".1f"), "low_measured": ("its dB", ".1f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("scenes, each with its cameras or without: SCENE[=VIEWS]")
    targets: tuple[str, ...] = setting(("36", "40", "43"), f"dB, or {DEFAULT} for no target")
    pictures: int = setting(64, "pictures that measure a rung, each of its own view")


def run(options: Options, lab: Lab) -> Page:
    rows: list[Row] = []
    for spec in options.scenes:
        scene, _, cameras = spec.partition("=")
        sequence = open_sequence(scene, views=cameras or None)
        for target in options.targets:
            goal = None if target == DEFAULT else Goal(PSNR, float(target))
            folder = lab.folder / f"{name_of(spec)}-{target}.airgs"
            try:
                encode(sequence, folder, goal=goal)
            except AirgsError as error:
                lab.tell(f"{name_of(spec)} {target}: {error}")
                continue
            package = open_package(folder)
            seen = draw_views(package.manifest.region, options.pictures, SEED)
            rows += rows_of(name_of(spec), target, package, measure(package, sequence, seen, options.pictures))
    packages = [package_row(some) for some in by_package(rows)]
    tables = [Table("claims-shown", [row for row in packages if row["target"] == options.targets[-1]], COLUMNS)]
    data = [Table("claims-packages", packages, COLUMNS), Table("claims", [row.plain() for row in rows])]
    how = (
        f"Each rung is measured in {options.pictures} pictures from views drawn anew from the package's region; bytes "
        "are all that a viewer fetches."
    )
    return Page([Section(verdict(rows), tables=tables)], how, data=data)


@dataclass(frozen=True, slots=True)
class Measured:
    """PSNR in dB of one rung on fresh views."""

    mean: float  # errors pooled over pictures
    worst: float  # of a picture


@dataclass(frozen=True, slots=True)
class Row:
    """A rung of a package: what was promised and what was found."""

    scene: str
    target: str  # dB, or DEFAULT
    rung: str
    kilobytes: float  # a frame, of everything a viewer fetches
    manifests: float  # of these
    claimed: float | None  # dB; None: the package does not say
    claimed_worst: float | None  # dB, of the worst picture; None likewise
    measured: Measured
    ladder: bool  # whether the package says that no mixture of two other rungs beats it

    @property
    def off(self) -> float:
        """By how much more was found than was claimed, in dB; 0 where nothing was."""
        return 0.0 if self.claimed is None else self.measured.mean - self.claimed

    def plain(self) -> PlainRow:
        measured = {"measured": self.measured.mean, "worst": self.measured.worst, "off": round(self.off, 3)}
        return asdict(self) | measured


def measure(
    package: Package, sequence: GaussianSequence, cameras: Sequence[Camera], pictures: int
) -> dict[str, Measured]:
    """Every rung against the original in so many pictures, or a few more: evenly spaced frames, cameras in turn."""
    step = max(1, len(sequence) // pictures)
    frames = range((len(sequence) - 1) % step // 2, len(sequence), step)
    each = -(-pictures // len(frames))
    streams = rung_streams(package, frames)
    errors: dict[str, list[float]] = {name: [] for name in streams}
    turn = itertools.cycle(cameras)
    for number in frames:
        original = sequence.load([number]).frames[0]
        seen = [(camera, render(original, camera).rgb) for camera in itertools.islice(turn, each)]
        for name, stream in streams.items():
            shown = next(stream)
            errors[name] += [mse(render(shown, camera).rgb, picture) for camera, picture in seen]
    return {name: Measured(round(psnr(sum(e) / len(e)), 3), round(psnr(max(e)), 3)) for name, e in errors.items()}


def rows_of(scene: str, target: str, package: Package, found: dict[str, Measured]) -> list[Row]:
    rungs = rung_rows(package.manifest, package.manifest_bytes)
    manifests = package.manifest_bytes / package.manifest.frames / 1e3
    rows = []
    for r in sorted(rungs, key=lambda rung: -rung["bytes_per_frame"]):
        name, sizes = f"{r['key']}+{r['state']}", (r["bytes_per_frame"] / 1e3, manifests)
        rows.append(Row(scene, target, name, *sizes, r["psnr"], r["worst"], found[name], r["best"]))
    return rows


def by_package(rows: Sequence[Row]) -> list[list[Row]]:
    """The rungs of each package, by falling bytes."""
    names = dict.fromkeys((row.scene, row.target) for row in rows)
    return [[row for row in rows if (row.scene, row.target) == name] for name in names]


def package_row(rows: Sequence[Row]) -> PlainRow:
    """What people look at of a package: its top rung, the lowest of its ladder, how far the ladder's claims are off."""
    top = rows[0]
    ladder = [row for row in rows if row.ladder]
    low = ladder[-1] if ladder else top
    return {
        "scene": top.scene, "target": top.target, "kilobytes": top.kilobytes,
        "claimed": top.claimed, "measured": top.measured.mean, "claimed_worst": top.claimed_worst,
        "worst": top.measured.worst, "low_kilobytes": low.kilobytes, "low_measured": low.measured.mean,
        "off": max((row.off for row in ladder), key=abs, default=0.0),
        "beaten": " ".join(  # a rung with fewer bytes was measured to be at least as good
            row.rung for row in ladder
            if any(o.kilobytes < row.kilobytes and o.measured.mean >= row.measured.mean for o in rows)
        ),
    }  # fmt: skip


def verdict(rows: Sequence[Row]) -> str:
    packages = [package_row(some) for some in by_package(rows)]
    if not packages:
        return "No package could be made."
    off = [round(one["measured"] - one["claimed"], 2) for one in packages if one["claimed"] is not None]
    words = []
    if off:
        close = sum(abs(one) <= CLOSE_DB for one in off)
        words.append(
            f"of {len(off)} top rungs {close} are found within {CLOSE_DB:g} dB of their claims, all {min(off):+.2f} to "
            f"{max(off):+.2f} dB from them"
        )
    below = [one["claimed_worst"] - one["worst"] for one in packages if one["claimed_worst"] is not None]
    if below:
        words.append(f"the worst picture found is at most {max(0.0, *below):.1f} dB below the worst one claimed")
    words.append(f"rungs of ladders are off by {max((one['off'] for one in packages), key=abs):+.2f} dB at most")
    beaten = [f"{one['scene']} {one['target']}: {one['beaten']}" for one in packages if one["beaten"]]
    words.append(
        f"a cheaper rung beats {', '.join(beaten)}" if beaten else "no rung of a ladder is beaten by a cheaper one"
    )
    sentence = "; ".join(words)
    return f"{sentence[0].upper()}{sentence[1:]}."
