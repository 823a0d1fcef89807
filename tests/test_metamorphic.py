"""What changes nothing of a scene changes nothing of its package: relations that docs/results/numerics.md states."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from airgs_codec import encode
from tests import faces
from tests.faces import EncodeSettings, Gaussians, join_rows, mix_rows, placed
from tests.support.camera_files import FORMS
from tests.support.scenes import moving_frames

SETTINGS = replace(faces.as_fast(EncodeSettings()), check_pictures=16, threads=1)
FRAMES = moving_frames(300, 2)
RIG = faces.orbit_views(FRAMES[0], count=3, size=48)
UTM = np.array([448262.0, 5411932.0, 113.0])


@dataclass(frozen=True)
class Scene:
    frames: tuple[Gaussians, ...] = tuple(FRAMES)
    rig: tuple = tuple(RIG)
    form: str | None = "nerfstudio"  # of the cameras
    name: str = "{:06d}.ply"

    def moved(self, scale: float = 1.0, shift: float | np.ndarray = 0.0, form: str | None = "nerfstudio") -> "Scene":
        """In units of 1 / scale, from another origin; positions are doubles where it is far."""
        shift = np.broadcast_to(np.float64(shift), 3)
        frames = [g.placed(np.zeros(3), scale) for g in self.frames]
        if shift.any():
            frames = [replace(g, means=g.means.astype(np.float64) + shift) for g in frames]
        return replace(self, frames=tuple(frames), rig=tuple(placed(c, shift, scale) for c in self.rig), form=form)

    def each(self, change) -> "Scene":
        return replace(self, frames=tuple(change(g, t) for t, g in enumerate(self.frames)))

    def figures(self, folder):
        folder.mkdir()
        for number, g in enumerate(self.frames):
            faces.write_ply(folder / self.name.format(number), g)
        if self.form:
            FORMS[self.form](folder, list(self.rig))
        m = encode(folder, folder.with_suffix(".airgs"), SETTINGS).manifest
        quality = [faces.quality_of(m, level, level).psnr for level in (0, 1)]
        return m.groups[0].count, m.bytes_of(m.rung_files(0, 0)), quality


ORDER = np.random.default_rng(0).permutation(len(FRAMES[0]))


def with_row(at):
    one = FRAMES[0].take([0])
    return lambda g, t: join_rows([g, replace(one, means=np.array([[at(t), 0, 0]], np.float32))])


def unfinished(value, logit):
    """A row of each frame has such a position, and such an opacity; it is the next one in the next frame."""
    opacities = np.full(len(FRAMES[0]), logit, np.float32)
    return lambda g, t: mix_rows(
        g, replace(g, means=g.means + np.float32(value), opacity_logits=opacities), np.arange(len(g)) != t
    )


PLAIN = Scene()
RELATIONS = {  # what is changed, and by how much dB and bytes may then differ
    "a unit, a thousandth": (PLAIN.moved(1e-4), 0.01, 0.02),
    "a unit, COLMAP": (PLAIN.moved(0.37, form="colmap text"), 0.01, 0.02),
    "a unit, INRIA": (PLAIN.moved(1e4, form="inria"), 0.01, 0.02),
    "the origin, in doubles": (PLAIN.moved(shift=UTM), 0.1, 0.02),
    "order of rows": (PLAIN.each(lambda g, t: g.take(ORDER)), 0.05, 0.02),
    "a far row": (PLAIN.each(with_row(lambda t: 1e6)), 0.01, 0.001),
    "a row that leaves": (PLAIN.each(with_row(lambda t: 1e4 * (1 + t))), 0.01, 0.001),
    "a row in view that leaves": (PLAIN.each(with_row(lambda t: 1e9 * (t > 0))), 0.1, 0.02),
    "names of frames": (replace(PLAIN, name="Take2-frame_{}.ply"), 0, 0),
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return PLAIN.figures(tmp_path_factory.mktemp("plain") / "scene")


@pytest.mark.parametrize("name", RELATIONS)
def test_what_changes_nothing_changes_nothing(name, plain, tmp_path):
    scene, decibels, share = RELATIONS[name]
    rows, size, quality = scene.figures(tmp_path / "scene")
    assert rows == plain[0] and size == pytest.approx(plain[1], rel=share)
    assert quality == pytest.approx(plain[2], abs=decibels)


def test_what_is_not_finite_in_a_frame_is_a_row_that_is_not_drawn_there(tmp_path):
    broken, hidden = (PLAIN.each(unfinished(*row)) for row in ((np.nan, 1), (0, -20)))
    assert broken.figures(tmp_path / "broken") == hidden.figures(tmp_path / "hidden")


def test_another_order_of_cameras_or_frames_shown_twice_move_figures_by_less_than_they_are_sure_of(plain, tmp_path):
    twice = replace(PLAIN, frames=tuple(np.repeat(FRAMES, 2)))
    for scene, name, more in ((replace(PLAIN, rig=tuple(RIG[::-1])), "turned", 1.02), (twice, "twice", 1.3)):
        rows, size, quality = scene.figures(tmp_path / name)
        assert rows == pytest.approx(plain[0], rel=0.03) and size < more * plain[1]
        assert quality == pytest.approx(plain[2], abs=1.0)  # of a claim by twelve pictures of 48 pixels


def test_without_cameras_the_unit_decides_nothing_either(tmp_path):
    some, other = (PLAIN.moved(scale, form=None).figures(tmp_path / f"{scale}") for scale in (1.0, 1e-3))
    assert some[0] == other[0] and some[1] == pytest.approx(other[1], rel=0.02)
    assert some[2] == pytest.approx(other[2], abs=0.01)
