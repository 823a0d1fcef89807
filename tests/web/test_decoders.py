"""What the player makes of browsers: luma that is changed, decoders that are missing, taken away or broken."""

import numpy as np
import pytest

from airgs_codec.media.h264 import Pictures
from tests.faces import open_package
from tests.makers import probe_clip
from tests.support.browser import missing
from tests.support.media_page import look
from tests.support.paths import GOLDEN

FOX = open_package(GOLDEN / "fox")

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


def test_the_probe_is_what_its_maker_makes():
    """x264 may change what it writes; what it decodes to is checked in the browser."""
    sample = probe_clip.encode_probe()
    (decoded,) = Pictures([sample], "probe")
    assert np.array_equal(decoded, probe_clip.picture())
    assert probe_clip.text(sample).splitlines()[:8] == probe_clip.PATH.read_text().splitlines()[:8]


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


@pytest.fixture(scope="module")
def probed():
    steps = {"real": ("probe", {}), "uneven": ("uneven", {}), "unable": ("unable", {})}
    steps |= {f"{format} {change}": ("probe", {"format": format, "change": change}) for format, change in MOCKS}
    steps |= {f"hardware {helps}": ("hardware", {"helps": helps}) for helps in (True, False)}
    steps |= {what: ("lacking", {"what": what}) for what in ("VideoDecoder", "isSecureContext")}
    steps |= {f"watched {name}": ("watched", {"url": "golden/fox"} | harm) for name, harm in HARMS.items()}
    return look({name: (task, {"url": ""} | arguments) for name, (task, arguments) in steps.items()})[0]


HARMS = {
    "unharmed": {},
    "reclaimed": {"after": 1, "times": 1},
    "reclaimed again": {"after": 1, "times": 2},
    "broken": {"after": 0, "times": 99},
    "given up": {"abortAt": 0},
}


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


FRAMES = FOX.manifest.segments[0].stop
TIERS = sum(tier.count > 0 for tier in FOX.manifest.groups[0].tiers)


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
