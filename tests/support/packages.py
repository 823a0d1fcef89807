"""The packages that tests share, by name: each is encoded once in a run, by a function of its folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests import faces
from tests.faces import EncodeSettings, Gaussians, GaussianSequence, LevelSettings, encode, open_sequence
from tests.support import scenes
from tests.support.chirps import SOUNDING, write_chirping
from tests.support.paths import FOX
from tests.support.regions import QUICK, place, region
from tests.support.scenes import frozen, moving_frames, random_gaussians, room_behind_a_door, room_frames

TWO_LEVELS = (LevelSettings(0.0), LevelSettings(0.5, 2.0, quality=1))
SLOPED_LEVELS = (LevelSettings(0.0), LevelSettings(0.3, 2.0))
TIERED_LEVELS = (
    LevelSettings(0.0), LevelSettings(0.3, 1.5), LevelSettings(0.5, 2.0, 1, 1), LevelSettings(0.6, 3.0, 1, 1),
)  # fmt: skip
PLAIN = EncodeSettings(calibrate="none", measure_pictures=0, preset="veryfast", threads=1, keep_all=True)
GROUP = 3  # frames of a group of `keyframes` and `rows`
SEGMENT = 8  # frames of a segment of `lines`
SEEN = replace(region(place(0.0)), width=96, height=72)
TURNED = LevelSettings(0.6), LevelSettings(0.6, 2.0)  # most that swings is not updated
NTSC = Fraction(30_000, 1001)  # frames a second of `sound`


@dataclass(frozen=True)
class Encoded:
    """How a package is made of frames in memory."""

    groups: Callable[[], Sequence[Sequence[Gaussians]]]  # frames of each
    settings: EncodeSettings
    fps: float = 30.0
    cameras: bool = False  # around the first frame

    def scene(self) -> GaussianSequence:
        groups = self.groups()
        frames = [frame for group in groups for frame in group]
        cameras = faces.orbit_views(frames[0], count=4, size=64) if self.cameras else ()
        starts = np.cumsum([0, *(len(group) for group in groups[:-1])])
        sequence = GaussianSequence.from_arrays(frames, fps=self.fps, cameras=cameras)
        return replace(sequence, keyframes=tuple(starts.tolist()))

    def __call__(self, folder: Path) -> None:
        encode(self.scene(), folder, self.settings)


def laid_out(
    sequence: GaussianSequence, settings: EncodeSettings, span: tuple[int, int] | None = None
) -> faces.GroupLayout:
    """How a group, or all frames as one, is laid out."""
    views = faces.choose_views(sequence, settings)[0]
    settings = replace(settings, steps=settings.steps.at_scale(views.scale))
    frames = faces.Frames(sequence, 0, (span or (0, len(sequence)),))
    survey = faces.Survey.of(frames, views, faces.CPU)
    written = survey.needed(settings.row_error if views.trusted else None)
    loaded = faces.turn_least(sequence.load(range(frames.start, frames.stop)))
    return faces.lay_out(loaded, frames, survey, written, views, settings)


def fox(folder: Path) -> None:
    settings = EncodeSettings(calibrate="none", measure_pictures=8, preset="veryfast", threads=2)
    encode(open_sequence(FOX), folder, settings)


def chirping(frames: int, fps: Fraction, group_frames: int) -> Callable[[Path], None]:
    """Groups that move, with a chirp as long as they."""

    def make(folder: Path) -> None:
        with TemporaryDirectory() as root:
            shutil.copytree(write_chirping(Path(root), frames, fps, group_frames), folder)

    return make


def silent(folder: Path) -> None:
    with TemporaryDirectory() as root:
        scene = scenes.write_sequence(Path(root), moving_frames(40, 39))
        encode(open_sequence(scene, fps=NTSC), folder, replace(SOUNDING, group_frames=13))


def kept_groups() -> list[list[Gaussians]]:
    """Groups that differ from an earlier one by nothing, by a part, by a little, by a mover, and by an open door.

    The 400 rows of groups 1 to 4: another room in the second, whose colours change in a part from the third on.
    380 rows, 5 to 8: colours change by a twentieth of a step, then those of 100 rows by thirty, then by nothing.
    5000 rows and a mover, 9 and 10. A room whose door is shut, and open, 11 and 12.
    """
    one, other, still = random_gaussians(400, seed=1), random_gaussians(400, seed=2), random_gaussians(380)
    coloured = replace(other, sh_dc=np.concatenate([other.sh_dc[:100] + 1, other.sh_dc[100:]]))
    change = np.zeros((380, 3), np.float32)
    change[:, 0] = 0.05 * QUICK.steps.keyframe.sh_dc
    slight = replace(still, sh_dc=still.sh_dc + change)
    change[:100, 0] = 30 * QUICK.steps.keyframe.sh_dc
    much = replace(still, sh_dc=still.sh_dc + change)
    room, doors = room_frames(5000, 2 * GROUP), [room_behind_a_door(1500, is_open) for is_open in (False, True)]
    alike = [one, other, coloured, coloured, still, slight, much, still]
    return [*([g] * GROUP for g in alike), room[:GROUP], room[GROUP:], *([g] * GROUP for g in doors)]


def pruned_groups() -> list[list[Gaussians]]:
    """Of which rows that pictures do not need are left out: a mover is not there, then is; a door is shut, then open.

    The last group is the first one without the last row, which is hidden there.
    """
    first, second = room_frames(1000, 1)[0], room_frames(1000, 3)[2]
    hidden = first.opacity_logits.copy()
    hidden[1000:] = -12
    away = replace(first, opacity_logits=hidden)
    doors = [room_behind_a_door(1500, is_open) for is_open in (False, True)]
    return [[g] * GROUP for g in (away, second, *doors, away.take(np.arange(len(away) - 1)))]


def drifting(count: int, frames: int) -> list[Gaussians]:
    """Every row moves evenly in a way of its own, turns and changes its colour; some go and come, some jump far."""
    rng, first = np.random.default_rng(3), random_gaussians(count)
    way, turn, dye = (rng.normal(size=(count, n)) * size for n, size in ((3, 0.02), (4, 0.01), (3, 0.02)))
    way[:5] *= 200  # past what 8 bits hold, slopes too
    coming = np.arange(count) % 7 == 0

    def frame(t: int) -> Gaussians:
        logits = np.where(coming & (t % 6 < 3), -9, first.opacity_logits)
        columns = first.means + t * way, first.quaternions + t * turn, first.log_scales, logits, first.sh_dc + t * dye
        return frozen(Gaussians(*(column.astype(np.float32) for column in (*columns, first.sh_rest))))

    return [frame(t) for t in range(frames)]


def sloped_groups() -> list[list[Gaussians]]:
    """Two segments of even motion, a frame alone, a segment of uneven motion, one in which a row jumps and returns."""
    rng, first, even = np.random.default_rng(1), random_gaussians(300), drifting(900, 2 * SEGMENT + 1)
    shifts = rng.normal(size=(SEGMENT, 300, 3)).astype(np.float32) / 9
    jump = moving_frames(200, 5)
    away = (np.arange(200) == 11)[:, None] * np.float32(500)
    jump[3] = replace(jump[3], means=jump[3].means + away)
    return [even[:-1], even[-1:], [replace(first, means=first.means + shift) for shift in shifts], jump]


def few_rows(degree: int = 0) -> list[list[Gaussians]]:
    return [moving_frames(count, 2, degree=degree) for count in (1, 2, 255, 256, 257)]


def few_groups() -> list[list[Gaussians]]:
    """Groups at the ends of what there may be, in segments of a frame: nothing moves, something that is away and back,
    constant colours and opacities, few rows and those about 16 times 16."""
    still, g = moving_frames(60, 1)[0], random_gaussians(80)
    there, back = (replace(still, means=still.means + np.float32(shift)) for shift in (0.1, -0.1))
    flat = replace(g, opacity_logits=np.full(80, 3, np.float32), sh_dc=np.ones((80, 3), np.float32))
    return [moving_frames(50, 1) * 5, [still, there, back], [flat], *few_rows()]


def dim_bands() -> list[list[Gaussians]]:
    """A scene with all SH bands, of which the first alone has values."""
    frames = moving_frames(400, 3, degree=3)
    rest = np.random.default_rng(0).normal(0, 0.5, frames[0].sh_rest.shape).astype(np.float32)
    rest[:, 3:] = 0
    return [[replace(g, sh_rest=rest) for g in frames]]


def swaying() -> list[list[Gaussians]]:
    """Ten groups of thirty frames of a scene that goes there and back."""
    there = moving_frames(60, 40)
    turn = [*there, *there[-2:0:-1]]
    return [[turn[t % len(turn)] for t in range(start, start + 30)] for start in range(0, 300, 30)]


def harmonic_frames() -> list[list[Gaussians]]:
    """Rows with all SH bands that move on evenly, every fifth one far."""
    first = random_gaussians(700, degree=3)
    way = np.random.default_rng(0).normal(size=(700, 3)) * np.where(np.arange(700) % 5, 0.02, 1.0)[:, None]
    return [[frozen(replace(first, means=(first.means + t * way).astype(np.float32))) for t in range(8)]]


KEPT_KEYFRAMES = replace(
    QUICK, decide_pictures=4, levels=(LevelSettings(0.0), LevelSettings(0.5, 2.0, tiers=1, quality=1))
)
PAPER = faces.as_in_paper(
    EncodeSettings(preset="ultrafast", threads=1, measure_pictures=1, decide_pictures=4, region=SEEN, quality=2.0)
)
PACKAGES: dict[str, Callable[[Path], object]] = {
    "fox": fox,
    "sound": chirping(39, NTSC, 13),
    "chirping": chirping(150, Fraction(25), 25),
    "silent": silent,
    "keyframes": Encoded(kept_groups, KEPT_KEYFRAMES, fps=GROUP),
    "rows": Encoded(pruned_groups, replace(KEPT_KEYFRAMES, keep_all=False), fps=GROUP),
    "slopes": Encoded(sloped_groups, replace(PLAIN, segment_s=SEGMENT / 30, levels=SLOPED_LEVELS), cameras=True),
    "few": Encoded(few_groups, replace(PLAIN, segment_s=1 / 30), cameras=True),
    "wide": Encoded(lambda: few_rows(3), replace(PLAIN, levels=TWO_LEVELS), cameras=True),
    "paper": Encoded(lambda: [moving_frames(200, 4)], PAPER),
    "calibrated": Encoded(dim_bands, EncodeSettings(preset="veryfast", threads=2), cameras=True),
    "harmonics": Encoded(harmonic_frames, replace(QUICK, segment_s=1.0, levels=TWO_LEVELS), fps=4, cameras=True),
    "drift": Encoded(swaying, replace(QUICK, preset="ultrafast", keyframes=faces.INTRA, levels=TIERED_LEVELS)),
    "turned": Encoded(lambda: [moving_frames(400, 4, 1)], replace(PLAIN, keep_all=False, levels=TURNED), cameras=True),
}
