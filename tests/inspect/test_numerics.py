"""`inspect --numerics`: each end that a sequence is taken to is told, with a bound that holds, and nothing else is."""

import json
import re

import numpy as np
import pytest
from scipy.spatial import cKDTree

from airgs_codec.cli.manifest import main
from airgs_codec.decoder.decode import decode_canonical
from airgs_codec.encoder.publish import encode
from airgs_codec.inspect.numerics import NAMES, format_numerics, measure_numerics
from airgs_codec.package.package import open_package
from airgs_codec.scene.gaussians import mean_frame, to_matrices
from airgs_codec.scene.sequence import open_sequence
from tests.support.paths import VALID
from tests.support.scenes import write_sequence
from tools.lab.numerics.sequences import CASES, Case, changed

VERDICTS = ("exact", "bounded by", "does not fit", "refused")
# Scenes of any kind may take escapes, few values or a decoded alpha under 0.
COMMON = {"codes past 8 bits", "motion past 8 bits", "coarse steps", "ends of opacity"}
SPREAD = Case("sizes of e^-12 and e^6", changed("log_scales", np.resize(np.float32([[-12], [6]]), (200, 1))))
TOUCHED = {
    "scale ratios of 1e6": {"needles"},
    SPREAD.name: {"spread of sizes", "half-float coordinates"},
    "1e6 from the origin, details of 1e-3": {"far coordinates", "half-float coordinates"},
    "opacity logits of -100 and +100": {"ends of opacity"},
    "zero quaternions": {"repaired rows"},
    "nan in sh_dc": {"repaired rows"},
    "SH DC of 1000": {"bright colours"},
    "a jump of 1e4 steps in one frame": {"motion past 8 bits"},
    "all Gaussians equal": set(),
}


@pytest.fixture(scope="module")
def encoded(tmp_path_factory):
    """A case of the extremes as frames and as a package, encoded once."""
    made = {}

    def get(name):
        if name not in made:
            (case,) = (case for case in (*CASES, SPREAD) if case.name == name)
            folder = tmp_path_factory.mktemp("numerics")
            frames = case.frames()
            encode(open_sequence(write_sequence(folder / "scene", frames)), folder / "out", case.settings)
            made[name] = frames, open_package(folder / "out")
        return made[name]

    return get


@pytest.mark.parametrize("name", TOUCHED)
def test_each_end_is_told_and_nothing_else(name, encoded):
    found = measure_numerics(encoded(name)[1])
    names = [one.what for one in found]
    assert names == [name for name in NAMES if name in names]  # each once, in order
    assert TOUCHED[name] <= set(names) and set(names) - TOUCHED[name] <= COMMON
    for one in found:
        assert one.verdict.startswith(VERDICTS) and 0 < one.rows <= one.of
    text = format_numerics(found)
    assert text.count("\n") == 2 * len(found) + 1 and "not touched: " in text.splitlines()[-1]
    assert not any(what in text.splitlines()[-1] for what in names)


def test_the_ends_of_needles_move_by_no_more_than_is_told(encoded):
    frames, package = encoded("scale ratios of 1e6")
    (told,) = (one for one in measure_numerics(package) if one.what == "needles")
    bound = float(re.search(r"no end moves by more than (\S+) units", told.verdict)[1])
    base, original = decode_canonical(package, 0, 0), mean_frame(frames)
    _, rows = cKDTree(original.means).query(base.means)
    assert len(set(rows.tolist())) == len(rows) == told.rows and told.size == pytest.approx(1e6, rel=0.2)
    longest = np.exp(base.log_scales.max(axis=1).astype(np.float64))[:, None]
    # Sequences may name axes anew: the end of the longest axis is that of its column, whichever its sign.
    ends = [
        np.take_along_axis(to_matrices(q), np.argmax(s, axis=1)[:, None, None], axis=2)[..., 0] * longest
        for q, s in ((base.quaternions, base.log_scales), (original.quaternions[rows], original.log_scales[rows]))
    ]
    moved = np.minimum(*(np.linalg.norm(ends[0] - sign * ends[1], axis=1) for sign in (1, -1)))
    assert 0.1 * bound < moved.max() <= bound


def test_coordinates_that_float32_cannot_hold_do_not_fit(encoded):
    (told,) = (one for one in measure_numerics(encoded("1e6 from the origin, details of 1e-3")[1]) if "far" in one.what)
    assert told.verdict.startswith("does not fit float32") and f"{1e6 * 2**-24:.3g}" in told.verdict


def test_repaired_rows_are_counted(encoded):
    (zero,) = (one for one in measure_numerics(encoded("zero quaternions")[1]) if one.what == "repaired rows")
    assert zero.rows == 50 and zero.verdict.startswith("exact")
    (broken,) = (one for one in measure_numerics(encoded("nan in sh_dc")[1]) if one.what == "repaired rows")
    assert broken.rows == 1 and broken.verdict.startswith("refused")


def test_motion_is_told_in_codes(encoded):
    _, package = encoded("a jump of 1e4 steps in one frame")
    (told,) = (one for one in measure_numerics(package) if one.what == "motion past 8 bits")
    assert told.rows == 50 and told.size > 1e4 and told.value.startswith("means")


@pytest.mark.parametrize("name", sorted(path.name for path in VALID.iterdir() if path.is_dir()))
def test_every_package_has_numerics(name, capsys):
    assert main(["inspect", str(VALID / name), "--numerics", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert all(set(row) >= {"what", "rows", "verdict"} for row in rows)
    assert main(["inspect", str(VALID / name), "--numerics"]) == 0
    assert capsys.readouterr().out.startswith("numerics: ")
