"""What a browser cannot do, or a server does, is a sentence on the screen: parts of Chromium are taken away before
scripts run, and files answered otherwise.
"""

from functools import partial

import pytest

from airgs_codec.serve.pages import PAGE
from tests.support.browser import Answer, build_pages, missing, serve, visit
from tests.support.paths import GOLDEN
from tests.support.servers import plainly_serving

SAYS = b"""<script type="module">
const element = document.querySelector("airgs-player");
const card = () => element.shadowRoot.querySelector(".card");
window.report = (async () => {
  while (!card() && !element.player?.stats.framesShown) await new Promise((resolve) => setTimeout(resolve, 20));
  const { width, height } = card()?.getBoundingClientRect() ?? {};
  return { text: card()?.innerText, seen: card()?.checkVisibility({ opacityProperty: true }), width, height };
})();
</script>"""
# What workers run comes as blobs.
IN_WORKERS = """
const Real = Blob;
globalThis.Blob = class extends Real {
  constructor(parts, options) {
    super(/javascript/.test(options?.type) ? [%r, ...parts] : parts, options);
  }
};"""
NO_CONTEXT = """
const { getContext } = HTMLCanvasElement.prototype;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind === "webgl2" ? null : getContext.call(this, kind, ...rest);
};"""
ONE_WORKER = """
const Started = Worker;
let count = 0;
globalThis.Worker = class extends Started {
  constructor(url, options) {
    super(++count > 1 ? "data:text/javascript,throw 1" : url, options);
  }
};"""
LACKING = {
    "HTTPS": ("Object.defineProperty(globalThis, 'isSecureContext', { value: false });", "only over HTTPS"),
    "WebCodecs": ("delete globalThis.VideoDecoder;", "It lacks WebCodecs."),
    "WebCodecs in workers": (IN_WORKERS % "delete globalThis.VideoDecoder;", "This browser has no WebCodecs"),
    "H.264": (
        IN_WORKERS % "VideoDecoder.isConfigSupported = async () => ({ supported: false });",
        "This browser does not decode H.264",
    ),
    "a decoder that works": (
        IN_WORKERS % "VideoDecoder.prototype.decode = function () { throw new Error('broken'); };",
        "This browser does not decode H.264",
    ),
    "WebGL 2": ("delete globalThis.WebGL2RenderingContext;", "It lacks WebGL 2"),
    "a WebGL 2 context": (NO_CONTEXT, "It lacks WebGL 2"),
    "workers": ("delete globalThis.Worker;", "The worker that decodes failed"),
    "more than one worker": (ONE_WORKER, "The worker that sorts failed"),
    "workers that start": (IN_WORKERS % "throw new Error('no such thing');", "The worker that decodes failed"),
}

HASTE = "const wait = setTimeout; globalThis.setTimeout = (run, ms) => wait(run, ms / 20);"
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

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}")


@pytest.fixture(scope="module")
def site():
    build_pages()
    page = (PAGE / "player.html").read_bytes() + SAYS
    root = (GOLDEN / "fox" / "airgs.json").read_bytes()
    served = {f"/{name}/airgs.json": lambda: root for name in SERVERS}
    served |= {f"/{name}/{path}": lambda given=given: given for name, (path, given, _) in SERVERS.items()}
    zipped = {"Content-Encoding": "gzip"}
    for path in ("group/1.json.gz", "group/2.json.gz"):
        served[f"/dev/fox/{path}"] = partial(Answer, (GOLDEN / "fox" / path).read_bytes(), headers=zipped)
    folders, made = {"page": PAGE, "golden": GOLDEN, "dev": GOLDEN}, {"/page/player.html": lambda: page}
    with serve(folders, made | served, locked={"dev": KEY}) as site:
        yield f"{site.url}/page/player.html?src=/golden/fox/"


@pytest.mark.parametrize("what", LACKING)
def test_what_is_lacking_is_said_on_the_screen(site, what):
    script, words = LACKING[what]
    report = visit(site, script).report
    assert report["seen"] and words in report["text"]
    assert report["width"] > 200 and report["height"] > 100


@pytest.mark.parametrize("src", ["/golden/fox/", f"/dev/fox/manifest.mpd{KEY}"], ids=["plain", "query, unpacked"])
def test_where_nothing_is_lacking_nothing_is_said(site, src):
    assert "text" not in visit(site.replace("/golden/fox/", src)).report


@pytest.mark.parametrize("name", [*SERVERS, "CORS"])
def test_what_a_server_does_is_said_on_the_screen(site, name):
    with plainly_serving(GOLDEN) as port:
        src = f"/{name}/" if name in SERVERS else f"http://127.0.0.1:{port}/fox/"
        report = visit(site.replace("/golden/fox/", src), IN_WORKERS % HASTE).report
    words = SERVERS[name][2] if name in SERVERS else "is not for this page"
    assert report["seen"] and words in report["text"] and "Try again" in report["text"]
