"""dash.js and shaka-player in a real browser: the MPD says to them what the tables say, and the pictures play."""

import re
from collections import defaultdict
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cached_property
from urllib.parse import urlencode, urlsplit

import numpy as np
import pytest

from tests.faces import (
    INIT_NAME,
    MPD_NAME,
    LevelSettings,
    LiveClock,
    encode,
    open_package,
    open_sequence,
    still_files,
    write_mpd,
)
from tests.support.browser import WEB, missing, serve, visit
from tests.support.paths import GOLDEN
from tests.support.regions import QUICK
from tests.support.scenes import moving_frames, write_sequence

PLAYERS = ("dashjs", "shaka")
KNOWN = (
    "internal Manifest structure is NOT covered",  # shaka says so to everybody who looks at what it parsed
    "Dropped frame ratio", "No alternate stream found",  # and so where the machine is slow
)  # fmt: skip
GROUPS = 5  # of a growing package, a second each
JOINED = 2  # groups that are there when a player comes
TIGHT_S = 1e-5  # players take the MPD's decimals and float ticks
GREY = 2  # largest difference of two channels of 8 bits

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module", params=["fox", "fox-fine"])
def package(request):
    """Two groups each; in the second one of fox-fine nothing moves, so that its state ends early."""
    return open_package(GOLDEN / request.param)


def look(folder, player, mpd=None, **query):
    """What a player that finds every file reports of the MPD in a folder, or of what `mpd` makes at each request."""
    path = f"/package/{MPD_NAME}"
    with serve({"web": WEB, "package": folder}, {path: mpd} if mpd else {}) as site:
        seen = visit(f"{site.url}/web/test/{player}.html?{urlencode({'mpd': path, **query})}")
    assert seen.complaints(KNOWN) == []
    assert seen.report["errors"] == []
    assert [answer for answer in site.answers if answer[1] >= 400] == []
    return seen.report


def expected(m):
    """Representation -> its files with the seconds when they begin and end, from the tables."""
    streams = defaultdict(list)
    for number, segment in enumerate(m.segments):
        for j in range(len(m.levels)):
            still = f"state/L{j}/{number + 1}.m4s"
            files = m.state_files(number, j) or [still for path, _ in still_files(m) if path == still]
            streams[f"L{j}"] += [(segment, path) for path in files]
    for number, group in enumerate(m.groups):
        for k, q in np.ndindex(m.tiers, len(m.qualities)):
            streams[f"T{k}/Q{q}"] += [(group, path) for path in m.key_files(number, k, q)[1:]]
    return {
        name: [(float(span.start / m.fps), float(span.stop / m.fps), path) for span, path in files]
        for name, files in streams.items()
        if files
    }


def paths(urls):
    return [urlsplit(url).path.removeprefix("/package/") for url in urls]


def test_shaka_finds_what_the_tables_say(package):
    report = look(package.files.path, "shaka")
    streams = expected(package.manifest)
    assert not report["live"]
    assert report["duration"] == pytest.approx(float(package.manifest.frames / package.manifest.fps), abs=TIGHT_S)
    assert {r["id"] for r in report["representations"]} == set(streams)
    sets = defaultdict(list)
    for r in report["representations"]:
        files = streams[r["id"]]
        assert [paths(s["urls"]) for s in r["segments"]] == [[path] for *_, path in files]
        assert [s["start"] for s in r["segments"]] == pytest.approx([start for start, *_ in files], abs=TIGHT_S)
        assert {path for s in r["segments"] for path in paths(s["init"])} == {INIT_NAME}
        sets[r["set"]].append(r["id"])
    assert sorted(map(sorted, sets.values())) == sorted(sets_of(streams).values())
    assert all((package.files.path / files[0][2]).is_file() for files in streams.values())


def sets_of(streams):
    """Representations by what their AdaptationSet says of them: the state, or a tier of the key."""
    kinds = defaultdict(list)
    for name in sorted(streams):
        tier = re.match(r"T(\d+)/", name)
        kinds[f"key;tier={tier[1]}" if tier else "state"].append(name)
    return kinds


def test_dashjs_finds_the_sets_and_plays_the_state(package):
    report = look(package.files.path, "dashjs")
    sets = sets_of(expected(package.manifest))
    assert sorted((s["role"], sorted(s["representations"])) for s in report["sets"]) == sorted(
        ([role], names) for role, names in sets.items()
    )
    assert {f["id"] for f in report["fragments"]} <= {*sets["state"]}
    assert not report["live"]


@pytest.mark.parametrize("player", PLAYERS)
@pytest.mark.parametrize("name", ["L0", "T0/Q0"])
def test_a_representation_plays_as_grey_video_to_its_end(package, player, name):
    m = package.manifest
    report = look(package.files.path, player, only=name)
    files = expected(m)[name]
    played = report["played"]
    frames = sum(round((stop - start) * m.fps) for start, stop, _ in files) if name[0] == "L" else len(files)
    assert played["frames"] == frames or (played["seeks"] and played["frames"] > frames)
    assert played["corrupted"] == 0
    assert played["stopped"] == pytest.approx(played["duration"], abs=TIGHT_S)
    assert played["colour"] <= GREY
    still = files[-1][2] in {path for path, _ in still_files(m)}
    assert played["brightest"] == played["darkest"] if still else played["brightest"] - played["darkest"] > 50
    if player == "dashjs":
        fragments = report["fragments"]
        media = [f for f in fragments if f["type"] == "MediaSegment"]
        assert paths(f["url"] for f in media) == [path for *_, path in files]
        times = [(f["start"], f["end"]) for f in media]
        assert np.array(times) == pytest.approx(np.array([span[:2] for span in files]), abs=TIGHT_S)
        assert set(paths(f["url"] for f in fragments if f["type"] == "InitializationSegment")) == {INIT_NAME}


@pytest.fixture(scope="module")
def growing(tmp_path_factory):
    """A package of GROUPS groups, all that will ever be there."""
    folder = tmp_path_factory.mktemp("growing")
    keyframes = [*range(0, 2 * GROUPS, 2)]
    scene = write_sequence(folder / "scene", moving_frames(200, 2 * GROUPS), fps=2, keyframes=keyframes)
    settings = replace(QUICK, levels=(LevelSettings(0.0),))
    encode(open_sequence(scene), folder / "growing.airgs", settings)
    return open_package(folder / "growing.airgs")


class Growth:
    """The MPD of a package that gains a group a second from the first time that somebody asks, and is then closed."""

    def __init__(self, package):
        self.package = package

    @cached_property
    def start(self):
        return datetime.now(UTC) - timedelta(seconds=JOINED)

    def mpd(self):
        m, now = self.package.manifest, datetime.now(UTC)
        groups = int((now - self.start).total_seconds())
        if groups >= GROUPS:
            return write_mpd(m)
        text = write_mpd(replace(m, live=True), LiveClock(self.start, now)).decode()
        run = f' r="{GROUPS - 1}"'
        assert text.count(run) == text.count("<S ")  # every timeline is one run
        return text.replace(run, f' r="{groups - 1}"').encode()


@pytest.mark.parametrize("player", PLAYERS)
def test_a_growing_package_is_joined_late_and_plays_on_to_its_end(growing, player):
    report = look(growing.files.path, player, Growth(growing).mpd, only="L0")
    assert report["live"]
    assert report["played"]["stopped"] == report["played"]["duration"] == pytest.approx(GROUPS, abs=TIGHT_S)
    assert report["played"]["colour"] <= GREY
    if player == "dashjs":
        media = [f["url"] for f in report["fragments"] if f["type"] == "MediaSegment"]
        assert paths(media)[-1] == f"state/L0/{GROUPS}.m4s"
