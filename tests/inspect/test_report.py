"""The page of an encode: what came out beside what was given, and what it concludes."""

import html
import math
import re
from dataclasses import replace

import pytest

from airgs_codec.inspect.report import advice, bought, holds_back, write_report
from tests import faces
from tests.faces import DELTA_E, PSNR, Goal, decode_frames, open_package
from tests.support.manifests import tiny_manifest
from tests.support.paths import VALID
from tests.support.views import moved

SECONDS = (0.1, 2.0, 3.0, 0.0, 6.0, 3.0)
DONE = faces.EncodeReport(tiny_manifest(), 0, faces.Restored(None), *SECONDS, cached=False, uncertainty=0.03)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The folder of a report on a package beside what it decodes to, but for a frame in which some rows are away."""
    package = open_package(VALID / "moving")
    frames = [frame.gaussians for frame in decode_frames(package, 0, 4)]
    frames[2] = moved(frames[2], slice(0, 12), (0.4, 0.2, 0.0))
    folder = tmp_path_factory.mktemp("report") / "made"
    sequence = faces.GaussianSequence.from_arrays(frames, fps=package.manifest.fps)
    write_report(folder, sequence, package, replace(DONE, manifest=package.manifest))
    return folder


def test_the_page_names_the_worst_frame_and_shows_it_and_a_film_of_both_sides(page):
    text = (page / "index.html").read_text()
    assert "Frame 2 is the worst" in text and "far below the others" in text
    assert set(re.findall(r'<img src="([^"]+)"', text)) == {"frame-000002.png"}
    assert faces.read_picture(page / "frame-000002.png").shape[1] > 3 * 300  # given, encoded, difference
    film = faces.VideoReader(page / "film.mp4")
    width, height = film.size
    assert len(film.clock.pictures) == 4 and width > height  # two pictures beside each other
    assert set(re.findall(r'(?:src|href)="([^"#]+)"', text)) <= {path.name for path in page.iterdir()}
    assert text.count("<figure") == 4 and html.escape(bought(DONE.stages())).split(".")[0] in text


def test_keys_or_states_hold_it_back_whichever_costs_more_of_a_kilobyte():
    known = [rung for rung in faces.summarise(tiny_manifest(), 0).rungs if rung.state != "L2"]

    def words(*psnr):
        """Of Q0+L0, Q0+L1, Q1+L0 and Q1+L1, which cost 12, 11, 10 and 9 kB a frame."""
        return holds_back([replace(known[i], bytes_per_frame=1e3 * (12 - i), psnr=db) for i, db in enumerate(psnr)])

    states, keys = words(44.0, 40.0, 42.0, 39.0), words(44.0, 43.0, 38.0, 37.0)
    assert states.startswith("Its states hold it back") and "costs 4.0 dB, of its keys 1.0 dB" in states
    assert keys.startswith("Its keys hold it back") and "costs 3.0 dB, of its states 1.0 dB" in keys
    assert words(None, None, None, None) == words(44.0, 43.0) == ""


def test_what_each_second_bought_begins_with_what_took_longest():
    told = bought(DONE.stages())
    assert told.startswith("14 s in all. Encoding took 6.0 s: the package, at the first attempt.")
    assert "Order of rows" not in told and "Calibration took 3.0 s: nothing" in told
    assert "good to 0.3 dB" in told
    top = DONE.manifest.bytes_of(DONE.manifest.rung_files(0, 0)) / DONE.manifest.frames
    trials = ((1.0, 42.0), (1.3, 40.05), (1.2, 41.0))
    found = replace(DONE, search_s=12.0, goal=Goal(PSNR, 40.0), trials=trials)
    more = replace(found, saved=top / 3, cached=True, repairs=("L1",))
    told = bought(more.stages())
    assert "Search took 12.0 s: 3 trials for 40 PSNR, from 42 to 41. Encoding took 6.0 s: L1." in told
    assert "save about 25 % of the bytes at equal error, which an earlier run found" in told
    assert "--quality 1.3 " in advice(more)
    colours = replace(more, goal=Goal(DELTA_E, 0.5), trials=((1.0, 0.6), (0.8, 0.5)))
    assert "3 trials" not in bought(colours.stages()) and advice(colours) == ""  # a factor alone does not give it again


def test_advice_follows_what_took_the_time_and_how_sure_the_claim_is():
    assert advice(DONE) == ""
    assert "Fewer --measure-pictures" in advice(replace(DONE, measure_s=60.0))
    for uncertainty in (0.2, math.inf):  # infinite: of one picture
        assert "more --measure-pictures" in advice(replace(DONE, measure_s=60.0, uncertainty=uncertainty))
    assert faces.certainty_words(math.inf).startswith("of a single picture")
    assert "--calibrate none" in advice(replace(DONE, calibrate_s=60.0))
