"""dash.js and shaka-player in a real browser: the MPD says to them what the tables say, and the pictures play."""

import re
from collections import defaultdict
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cached_property
from urllib.parse import urlencode, urlsplit

import numpy as np
import pytest

from tests.faces import INIT_NAME, MPD_NAME, LevelSettings, LiveClock, open_package, still_files, write_mpd
from tests.support.browser import WEB, missing, serve, visit_all
from tests.support.packages import Encoded
from tests.support.paths import GOLDEN
from tests.support.regions import QUICK
from tests.support.scenes import moving_frames

PLAYERS = ("dashjs", "shaka")
KNOWN = (
    "internal Manifest structure is NOT covered",  # shaka says so to everybody who looks at what it parsed
    "Dropped frame ratio", "No alternate stream found",  # and so where the machine is slow
)  # fmt: skip
GROUPS = 4  # of a growing package, a second each
JOINED = 2  # groups that are there when a player comes
TIGHT_S = 1e-5  # players take the MPD's decimals and float ticks
GREY = 2  # largest difference of two channels of 8 bits

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")
# Two groups each; in the second one of fox-fine nothing moves, so that its state ends early.
PACKAGES = {name: open_package(GOLDEN / name) for name in ("fox", "fox-fine")}
ONLY = ("L0", "T0/Q0")
VISITS = [
    *(("growing", player, "L0") for player in PLAYERS),
    *((package, player, only) for package in PACKAGES for player in PLAYERS for only in ("", *ONLY)),
]


class Growth:
    """The MPD of a package that gains a group a second from the first time that somebody asks, and is then closed."""

    def __init__(self, package):
        self.m = package.manifest

    @cached_property
    def start(self):
        return datetime.now(UTC) - timedelta(seconds=JOINED)

    def mpd(self):
        groups = int((datetime.now(UTC) - self.start).total_seconds())
        if groups >= GROUPS:
            return write_mpd(self.m)
        text = write_mpd(replace(self.m, live=True), LiveClock(self.start, datetime.now(UTC))).decode()
        run = f' r="{GROUPS - 1}"'
        assert text.count(run) == text.count("<S ")  # every timeline is one run
        return text.replace(run, f' r="{groups - 1}"').encode()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """What players report: (package, player, one of its Representations, or "" for all) -> that."""
    growing, frames = tmp_path_factory.mktemp("growing") / "package", moving_frames(200, 2 * GROUPS)
    groups = [frames[at : at + 2] for at in range(0, 2 * GROUPS, 2)]
    Encoded(lambda: groups, replace(QUICK, levels=(LevelSettings(0.0),)), fps=2, cameras=True)(growing)
    folders = {"web": WEB} | {name: package.files.path for name, package in PACKAGES.items()}
    folders |= {f"growing-{player}": growing for player in PLAYERS}
    made = {f"/growing-{player}/{MPD_NAME}": Growth(open_package(growing)).mpd for player in PLAYERS}
    pages = []
    with serve(folders, made) as site:
        for package, player, only in VISITS:
            folder = f"growing-{player}" if package == "growing" else package
            query = {"mpd": f"/{folder}/{MPD_NAME}"} | ({"only": only} if only else {})
            pages.append((f"{site.url}/web/test/{player}.html?{urlencode(query)}", ""))
        visits = visit_all(pages)
    assert [answer for answer in site.answers if answer[1] >= 400] == []
    assert [(seen.complaints(KNOWN), seen.report["errors"]) for seen in visits] == [([], [])] * len(VISITS)
    return {visit: seen.report for visit, seen in zip(VISITS, visits, strict=True)}


def expected(m):
    """Representation -> its files with the seconds when they begin and end, from the tables."""
    streams = defaultdict(list)

    def add(name, span, paths):
        streams[name] += [(float(span.start / m.fps), float(span.stop / m.fps), path) for path in paths]

    for number, segment in enumerate(m.segments):
        for j in range(len(m.levels)):
            still = [path for path, _ in still_files(m) if path == f"delta/L{j}/{number + 1}.m4s"]
            add(f"L{j}", segment, m.delta_files(number, j) or still)
    for number, group in enumerate(m.groups):
        for k, q in np.ndindex(m.tiers, len(m.qualities)):
            add(f"T{k}/Q{q}", group, m.keyframe_files(number, k, q)[1:])
    return {name: files for name, files in streams.items() if files}


def sets_of(streams):
    """Representations by what their AdaptationSet says of them: the deltas, or a keyframe tier."""
    kinds = defaultdict(list)
    for name in sorted(streams):
        tier = re.match(r"T(\d+)/", name)
        kinds[f"keyframe;tier={tier[1]}" if tier else "delta"].append(name)
    return kinds


def paths(urls):
    return [urlsplit(url).path.split("/", 2)[2] for url in urls]


@pytest.mark.parametrize("name", PACKAGES)
def test_shaka_finds_what_the_tables_say(report, name):
    seen, package = report[name, "shaka", ""], PACKAGES[name]
    m, streams = package.manifest, expected(package.manifest)
    assert not seen["live"] and seen["duration"] == pytest.approx(float(m.frames / m.fps), abs=TIGHT_S)
    assert {r["id"] for r in seen["representations"]} == set(streams)
    sets = defaultdict(list)
    for r in seen["representations"]:
        files = streams[r["id"]]
        assert [paths(s["urls"]) for s in r["segments"]] == [[path] for *_, path in files]
        assert [s["start"] for s in r["segments"]] == pytest.approx([start for start, *_ in files], abs=TIGHT_S)
        assert {path for s in r["segments"] for path in paths(s["init"])} == {INIT_NAME}
        sets[r["set"]].append(r["id"])
    assert sorted(map(sorted, sets.values())) == sorted(sets_of(streams).values())
    assert all((package.files.path / files[0][2]).is_file() for files in streams.values())


@pytest.mark.parametrize("name", PACKAGES)
def test_dashjs_finds_the_sets_and_plays_the_delta(report, name):
    seen, sets = report[name, "dashjs", ""], sets_of(expected(PACKAGES[name].manifest))
    found = [(s["role"], sorted(s["representations"])) for s in seen["sets"]]
    assert sorted(found) == sorted(([role], names) for role, names in sets.items())
    assert {f["id"] for f in seen["fragments"]} <= {*sets["delta"]} and not seen["live"]


@pytest.mark.parametrize("player", PLAYERS)
@pytest.mark.parametrize("only", ONLY)
@pytest.mark.parametrize("name", PACKAGES)
def test_a_representation_plays_as_grey_video_to_its_end(report, name, player, only):
    m, seen = PACKAGES[name].manifest, report[name, player, only]
    files, played = expected(m)[only], seen["played"]
    frames = sum(round((stop - start) * m.fps) for start, stop, _ in files) if only[0] == "L" else len(files)
    assert played["frames"] == frames or (played["seeks"] and played["frames"] > frames)
    assert played["corrupted"] == 0 and played["colour"] <= GREY
    assert played["stopped"] == pytest.approx(played["duration"], abs=TIGHT_S)
    still = files[-1][2] in {path for path, _ in still_files(m)}
    assert played["brightest"] == played["darkest"] if still else played["brightest"] - played["darkest"] > 50
    if player == "dashjs":
        media = [f for f in seen["fragments"] if f["type"] == "MediaSegment"]
        assert paths(f["url"] for f in media) == [path for *_, path in files]
        times = [(f["start"], f["end"]) for f in media]
        assert np.array(times) == pytest.approx(np.array([span[:2] for span in files]), abs=TIGHT_S)
        assert {*paths(f["url"] for f in seen["fragments"] if f["type"] == "InitializationSegment")} == {INIT_NAME}


@pytest.mark.parametrize("player", PLAYERS)
def test_a_growing_package_is_joined_late_and_plays_on_to_its_end(report, player):
    seen = report["growing", player, "L0"]
    played = seen["played"]
    assert seen["live"] and played["colour"] <= GREY
    assert played["stopped"] == played["duration"] == pytest.approx(GROUPS, abs=TIGHT_S)
    if player == "dashjs":
        media = [f["url"] for f in seen["fragments"] if f["type"] == "MediaSegment"]
        assert paths(media)[-1] == f"delta/L0/{GROUPS}.m4s"
