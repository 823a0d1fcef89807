"""What a browser cannot do, or does otherwise, or a server does: named by the media part, and said on the screen."""

import base64
import re

import numpy as np
import pytest

from airgs_codec.media.h264 import Pictures
from tests.faces import open_package
from tests.makers.probe_clip import PATH as PROBE
from tests.support.browser import Answer, missing, serve, visit_all
from tests.support.page import SHIPPED, asking, do_tasks
from tests.support.paths import GOLDEN
from tests.support.servers import plainly_serving

LACKING = {  # what is taken away by web/test/support/lacking.ts, and what is said
    "HTTPS": "only over HTTPS", "WebCodecs": "It lacks WebCodecs.",
    "WebCodecs in workers": "This browser has no WebCodecs", "H.264": "This browser does not decode H.264",
    "a decoder that works": "This browser does not decode H.264",
    "WebGL 2": "It lacks WebGL 2", "a WebGL 2 context": "It lacks WebGL 2",
    "workers": "The worker that decodes failed", "more than one worker": "The worker that sorts failed",
    "workers that start": "The worker that decodes failed",
}  # fmt: skip
KEY = "?sig=a%2Fb%2Bc&x=1"
PAGE = "group/1.json.gz"
SERVERS = {  # the file that is answered otherwise, how, and what is said
    "401": ("airgs.json", Answer(status=401), "needs a sign-in"),
    "403": (PAGE, Answer(status=403), f"{PAGE}: expected a file, got status 403. Its server refuses"),
    "page": ("airgs.json", Answer(b"<!doctype html>"), "A web page is there"),
    "silent": ("airgs.json", Answer(b"{{", wait_s=60), "airgs.json: the server is silent"),
}
SAID = LACKING | {name: words for name, (*_, words) in SERVERS.items()} | {"CORS": "is not for this page"}
FOX = open_package(GOLDEN / "fox")

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def shown():
    """What the page that is shipped shows, by what is lacking, where nothing is, and by what a server does."""
    made = {f"/{name}/airgs.json": (GOLDEN / "fox" / "airgs.json").read_bytes() for name in SERVERS}
    made |= {f"/{name}/{path}": given for name, (path, given, _) in SERVERS.items()}
    for path in (PAGE, "group/2.json.gz"):
        made[f"/dev/fox/{path}"] = Answer((GOLDEN / "fox" / path).read_bytes(), headers={"Content-Encoding": "gzip"})
    folders = {"page": SHIPPED, "golden": GOLDEN, "dev": GOLDEN}
    with serve(folders, made, locked={"dev": KEY}) as site, plainly_serving(GOLDEN) as port:
        pages = {name: ("/golden/fox/", asking(lacks=name)) for name in LACKING}
        pages["nothing"] = f"/dev/fox/manifest.mpd{KEY}", asking()  # lacks, or is wrong
        pages |= {name: (f"/{name}/", asking(lacks="patience" if name == "silent" else "")) for name in SERVERS}
        pages["CORS"] = f"http://127.0.0.1:{port}/fox/", asking()
        visits = visit_all([(f"{site.url}/page/player.html?src={src}", script) for src, script in pages.values()])
    return {name: seen.report for name, seen in zip(pages, visits, strict=True)}


@pytest.mark.parametrize("name", SAID)
def test_what_is_lacking_or_a_server_does_is_said_on_the_screen(shown, name):
    report = shown[name]
    assert report["seen"] and SAID[name] in report["text"]
    assert report["width"] > 200 and report["height"] > 100
    assert name in LACKING or "Try again" in report["text"]


def test_a_package_with_a_key_in_its_address_and_tables_that_the_browser_unpacks_is_shown(shown):
    assert "text" not in shown["nothing"]


# In the media part: luma that is changed, decoders that are missing, taken away or broken

MOCKS = (  # formats of pictures, what becomes of their luma, and whether it can be had: "luma" is not
    ("NV12", "same", "exact"), ("I420", "same", "exact"), ("BGRX", "same", "exact"),
    ("BGRX", "stretched", "invertible"), ("RGBA", "stretched", "invertible"), ("RGBX", "negative", "invertible"),
    (None, "stretched", "invertible"), ("NV12", "stretched", "invertible"),
    ("BGRX", "squeezed", None), ("I420", "clipped", None), ("BGRX", "clipped", None), ("I444", "same", None),
)  # fmt: skip
PROBES = {  # task of web/test/pages/media.ts, with what -> what it reports, or words of an UnsupportedError
    "this browser": ("probe", {}, {"luma": "exact", "layouts": ["planar"], "wrong": []}),
    "uneven": ("uneven", {}, "changes the luma"),
    "unable": ("unable", {}, "does not decode H.264"),
    "no decoder": ("lacking", {"what": "VideoDecoder"}, "no WebCodecs"),
    "not secure": ("lacking", {"what": "isSecureContext"}, "https"),
    "software where hardware differs": (
        "hardware", {"helps": True}, {"wrong": [], "asked": ["no-preference", "prefer-software"]},
    ),
    "software that differs, too": ("hardware", {"helps": False}, "luma"),
}  # fmt: skip
for format, change, luma in MOCKS:
    undone = {"luma": luma, "layouts": ["planar" if format in ("NV12", "I420") else "rgb"], "wrong": []}
    PROBES[f"{format} {change}"] = "probe", {"format": format, "change": change}, undone if luma else "luma"
ALL = list(range(FOX.manifest.segments[0].stop))
BROKEN = "keyframe/T0/Q0/1.m4s: H.264 does not decode: Codec reclaimed due to inactivity. (bad_picture)"
HARMS = {  # done to decoders -> how many are made, one for keys and one for states at first, frames that come, words
    "unharmed": ({}, {"made": 2, "came": ALL, "said": ""}),
    "reclaimed": ({"after": 1, "times": 1}, {"made": 3, "came": ALL, "said": ""}),
    "reclaimed again": ({"after": 1, "times": 2}, {}),
    "broken": (
        {"after": 0, "times": 99},
        {"made": 3, "came": [], "said": BROKEN},
    ),  # when it comes, and when it is asked for
    "given up": ({"abortAt": 0}, {"came": [0], "said": "given up"}),
}


def test_the_probe_is_a_picture_of_every_luma():
    """So that the browser's is compared with what Python decodes, too."""
    letters = "".join(re.findall(r'"([A-Za-z0-9+/=]+)"', PROBE.read_text()))
    (decoded,) = Pictures([base64.b64decode(letters)], "probe")
    assert np.array_equal(decoded, np.kron(np.arange(256).reshape(16, 16), np.ones((16, 16))))


@pytest.fixture(scope="module")
def probed():
    steps = {name: (task, {"url": ""} | arguments) for name, (task, arguments, _) in PROBES.items()}
    steps |= {name: ("watched", {"url": "golden/fox"} | harm) for name, (harm, _) in HARMS.items()}
    return do_tasks(steps)


@pytest.mark.parametrize("name", PROBES)
def test_luma_that_is_changed_is_undone_or_refused_and_what_a_browser_lacks_is_named(probed, name):
    report, expected = probed[name], PROBES[name][-1]
    if isinstance(expected, str):
        assert report["error"]["name"] == "UnsupportedError" and expected in report["error"]["message"]
    else:
        assert report == expected


@pytest.mark.parametrize("name", HARMS)
def test_a_decoder_that_was_taken_away_is_made_anew_and_every_picture_is_closed_whatever_happens(probed, name):
    report, (_, expected) = probed[name], HARMS[name]
    assert report | expected | {"unclosed": 0} == report
