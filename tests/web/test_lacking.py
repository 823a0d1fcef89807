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

MOCKS = {
    ("NV12", "same"): "exact",
    ("I420", "same"): "exact",
    ("BGRX", "same"): "exact",
    ("BGRX", "stretched"): "invertible",
    ("RGBA", "stretched"): "invertible",
    ("RGBX", "negative"): "invertible",
    (None, "stretched"): "invertible",
    ("NV12", "stretched"): "invertible",
    ("BGRX", "squeezed"): None,
    ("I420", "clipped"): None,
    ("BGRX", "clipped"): None,
    ("I444", "same"): None,
}


HARMS = {
    "unharmed": {},
    "reclaimed": {"after": 1, "times": 1},
    "reclaimed again": {"after": 1, "times": 2},
    "broken": {"after": 0, "times": 99},
    "given up": {"abortAt": 0},
}
LACKING = {  # what is taken away by web/test/support/lacking.ts, and what is said
    "HTTPS": "only over HTTPS",
    "WebCodecs": "It lacks WebCodecs.",
    "WebCodecs in workers": "This browser has no WebCodecs",
    "H.264": "This browser does not decode H.264",
    "a decoder that works": "This browser does not decode H.264",
    "WebGL 2": "It lacks WebGL 2",
    "a WebGL 2 context": "It lacks WebGL 2",
    "workers": "The worker that decodes failed",
    "more than one worker": "The worker that sorts failed",
    "workers that start": "The worker that decodes failed",
}
KEY = "?sig=a%2Fb%2Bc&x=1"
SERVERS = {  # the file that is answered otherwise, how, and what is said
    "401": ("airgs.json", Answer(status=401), "needs a sign-in"),
    "403": (
        "group/1.json.gz",
        Answer(status=403),
        "group/1.json.gz: expected a file, got status 403. Its server refuses",
    ),
    "page": ("airgs.json", Answer(b"<!doctype html>"), "A web page is there"),
    "silent": ("airgs.json", Answer(b"{{", wait_s=60), "airgs.json: the server is silent"),
}

NOTHING = {"plain": "/golden/fox/", "query, unpacked": f"/dev/fox/manifest.mpd{KEY}"}  # lacks, or is wrong
FOX = open_package(GOLDEN / "fox")
FRAMES = FOX.manifest.segments[0].stop

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


# On the screen


@pytest.fixture(scope="module")
def shown():
    """What the page that is shipped shows, by what is lacking, where nothing is, and by what a server does."""
    root = (GOLDEN / "fox" / "airgs.json").read_bytes()
    made = {f"/{name}/airgs.json": root for name in SERVERS}
    made |= {f"/{name}/{path}": given for name, (path, given, _) in SERVERS.items()}
    for path in ("group/1.json.gz", "group/2.json.gz"):
        made[f"/dev/fox/{path}"] = Answer((GOLDEN / "fox" / path).read_bytes(), headers={"Content-Encoding": "gzip"})
    folders = {"page": SHIPPED, "golden": GOLDEN, "dev": GOLDEN}
    with serve(folders, made, locked={"dev": KEY}) as site, plainly_serving(GOLDEN) as port:
        pages = {name: ("/golden/fox/", asking(lacks=name)) for name in LACKING}
        pages |= {name: (src, asking()) for name, src in NOTHING.items()}
        pages |= {name: (f"/{name}/", asking(lacks="patience" if name == "silent" else "")) for name in SERVERS}
        pages["CORS"] = f"http://127.0.0.1:{port}/fox/", asking()
        visits = visit_all([(f"{site.url}/page/player.html?src={src}", script) for src, script in pages.values()])
    return {name: seen.report for name, seen in zip(pages, visits, strict=True)}


@pytest.mark.parametrize("what", LACKING)
def test_what_is_lacking_is_said_on_the_screen(shown, what):
    report = shown[what]
    assert report["seen"] and LACKING[what] in report["text"]
    assert report["width"] > 200 and report["height"] > 100


@pytest.mark.parametrize("name", NOTHING)
def test_where_nothing_is_lacking_nothing_is_said(shown, name):
    assert "text" not in shown[name]


@pytest.mark.parametrize("name", [*SERVERS, "CORS"])
def test_what_a_server_does_is_said_on_the_screen(shown, name):
    report = shown[name]
    words = SERVERS[name][2] if name in SERVERS else "is not for this page"
    assert report["seen"] and words in report["text"] and "Try again" in report["text"]


# In the media part: luma that is changed, decoders that are missing, taken away or broken


def test_the_probe_is_a_picture_of_every_luma():
    """So that the browser's is compared with what Python decodes, too."""
    letters = "".join(re.findall(r'"([A-Za-z0-9+/=]+)"', PROBE.read_text()))
    (decoded,) = Pictures([base64.b64decode(letters)], "probe")
    assert np.array_equal(decoded, np.kron(np.arange(256).reshape(16, 16), np.ones((16, 16))))


@pytest.fixture(scope="module")
def probed():
    steps = {"real": ("probe", {}), "uneven": ("uneven", {}), "unable": ("unable", {})}
    steps |= {f"{format} {change}": ("probe", {"format": format, "change": change}) for format, change in MOCKS}
    steps |= {f"hardware {helps}": ("hardware", {"helps": helps}) for helps in (True, False)}
    steps |= {what: ("lacking", {"what": what}) for what in ("VideoDecoder", "isSecureContext")}
    steps |= {f"watched {name}": ("watched", {"url": "golden/fox"} | harm) for name, harm in HARMS.items()}
    return do_tasks({name: (task, {"url": ""} | arguments) for name, (task, arguments) in steps.items()})


def test_this_browser_is_exact(probed):
    assert probed["real"] == {"luma": "exact", "layouts": ["planar"], "wrong": []}


@pytest.mark.parametrize(("format", "change"), MOCKS)
def test_luma_that_is_changed_is_undone_or_refused(probed, format, change):
    report, luma = probed[f"{format} {change}"], MOCKS[format, change]
    if luma is None:
        assert report["error"]["name"] == "UnsupportedError"
        assert "luma" in report["error"]["message"]
    else:
        layout = "planar" if format in ("NV12", "I420") else "rgb"
        assert report == {"luma": luma, "layouts": [layout], "wrong": []}


def test_software_decodes_what_hardware_gives_otherwise_than_the_probe(probed):
    assert probed["hardware True"] == {"wrong": [], "asked": ["no-preference", "prefer-software"]}
    assert probed["hardware False"]["error"]["name"] == "UnsupportedError"


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("uneven", "changes the luma"),
        ("unable", "does not decode H.264"),
        ("VideoDecoder", "no WebCodecs"),
        ("isSecureContext", "https"),
    ],
)
def test_what_a_browser_lacks_is_named(probed, what, words):
    assert probed[what]["error"]["name"] == "UnsupportedError"
    assert words in probed[what]["error"]["message"]


def test_every_picture_is_closed_whatever_happens(probed):
    for name in HARMS:
        assert probed[f"watched {name}"]["unclosed"] == 0, name


@pytest.mark.parametrize("name", ["unharmed", "reclaimed"])
def test_a_decoder_that_was_taken_away_is_made_anew(probed, name):
    report = probed[f"watched {name}"]
    assert (report["came"], report["said"]) == (list(range(FRAMES)), "")
    assert report["made"] == 2 + HARMS[name].get("times", 0)  # one for keys, one for states


def test_a_decoder_that_breaks_down_again_counts(probed):
    report = probed["watched broken"]
    assert report["came"] == [] and "H.264 does not decode" in report["said"]
    assert report["made"] == 2


def test_decoding_that_is_given_up_ends(probed):
    report = probed["watched given up"]
    assert report["came"] == [0] and report["said"] == "given up"
