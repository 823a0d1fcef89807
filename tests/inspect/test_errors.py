"""max_error: kept by every package, measured again against the original, and found when it is a lie."""

import numpy as np
import pytest

from airgs_codec.inspect import errors
from tests import faces
from tests.faces import KEY, STATE, STATIC, decode_canonical, measure_errors, open_package, open_sequence
from tests.makers.refusals import TABLE
from tests.support.mutations import on_disk, reindexed, set_value
from tests.support.paths import FOX
from tests.support.scenes import moving_frames, write_sequence


@pytest.fixture(scope="module")
def turned(made_once):
    """A package without the rows that pictures do not need, in which most that swings is not updated; its sequence."""

    def make(folder):
        sequence = open_sequence(write_sequence(folder / "scene", moving_frames(400, 4, 1)))
        levels = faces.LevelSettings(0.6), faces.LevelSettings(0.6, 2.0)
        fast = faces.EncodeSettings(calibrate="none", measure_pictures=0, preset="veryfast", threads=2, levels=levels)
        faces.encode(sequence, folder / "out", fast)

    folder = made_once("turned", make)
    return open_package(folder / "out"), open_sequence(folder / "scene")


def test_every_atlas_keeps_its_bound_and_the_bound_is_tight_and_wider_in_coarser_levels(demo_package):
    package = open_package(demo_package)
    m, measured = package.manifest, list(measure_errors(package, open_sequence(FOX)))
    assert len({e.where for e in measured}) == len(m.groups) * (m.tiers * len(m.qualities) + len(m.levels))
    assert {e.attribute for e in measured if "key" in e.where} == set(KEY.attributes)
    assert {e.attribute for e in measured if "state" in e.where} == set(STATE.attributes)
    for e in measured:
        assert e.error <= e.bound, e
        assert e.ambiguous <= 0.02 * e.rows
    ratios = [e.error / e.bound for e in measured if e.bound]
    assert np.median(ratios) > 0.9 and min(ratios) > 0.5  # at most a sixth of a step is lost to not looking closer
    for group in m.groups:
        bounds = np.array([atlas.max_error for atlas in group.levels])
        assert (bounds[-1] >= bounds[0]).all() and (bounds[-1] > bounds[0]).any()


def test_a_lie_is_found_and_another_sequence_refused(demo_copy, tmp_path, capsys):
    assert faces.airgs_manifest(["validate", str(demo_copy), "--against", str(FOX)]) == 0
    assert "measured / max_error" in capsys.readouterr().out
    promised = open_package(demo_copy).manifest.groups[0].levels[0].max_error[0]
    on_disk(demo_copy, set_value(("levels", 0, "max_error", 0), 0.5 * promised, TABLE), reindexed)
    assert faces.airgs_manifest(["validate", str(demo_copy), "--against", str(FOX)]) == 1
    assert "means: max_error" in capsys.readouterr().out
    other = open_sequence(write_sequence(tmp_path / "scene", moving_frames(20, 3)))
    with pytest.raises(faces.ConfigError, match="expected 10 frames"):
        list(measure_errors(open_package(demo_copy), other))


def test_rows_that_are_left_out_turned_or_never_updated_keep_their_promises(turned):
    """The rows are in another order; those that move and are never updated are found by their mean."""
    package, sequence = turned
    measured, base = list(measure_errors(package, sequence)), decode_canonical(package, 0, 0)
    assert faces.validate(package.files.path) == faces.exceeded(measured) == []
    assert max(m.ambiguous for m in measured) == 0 and all(e.error <= e.bound for e in measured)
    assert package.manifest.groups[0].left_out[0].what == "gaussians" and package.manifest.sh_degree == 1
    assert (base.depths == STATIC).sum() > 200  # of 305, half of which swing: most of them with no update
    assert sum(e.attribute == "quaternions" and "key" in e.where and e.rows > 0 for e in measured)
    assert np.linalg.norm(faces.to_rotation_vector(base.quaternions), axis=1).max() < np.radians(70)  # 62.8, and a step


def test_the_nearest_original_that_keeps_the_promise_is_taken_or_the_nearest():
    """One row is off by a little in all, and by too much in one; the other is further away, and within the promise."""
    originals, promised, found = np.zeros((3, 19)), np.full((2, 19), 0.5), np.zeros((2, 19))
    originals[0, 0], originals[1, :], originals[2, :] = 0.6, 0.4, 9.0
    assert errors._nearest(originals, found, promised).tolist() == [1, 1]
    promised[1, 18] = 0.1
    assert errors._nearest(originals, found, promised).tolist() == [1, 0]


def test_promises_are_in_the_units_of_what_is_compared(demo_package):
    """Means of a row with twice the motion unit may err by twice as much."""
    package = open_package(demo_package)
    base, group = decode_canonical(package, 0, 0), package.manifest.groups[0]
    promised = errors._promised(group, base)
    moving = base.depths != STATIC
    ratio = base.motion_units / np.median(base.motion_units)
    bound = group.levels[0].max_error[0] / group.state_steps.means
    np.testing.assert_allclose(promised[moving, 0], bound * ratio[moving], rtol=1e-6)
    assert moving.any() and len(np.unique(ratio[moving])) > 1
