"""Chromium, Firefox and WebKitGTK as people start them: with the address of a page, and nothing that drives them.

A page reports by POST, and is answered with the address of the page after it, so that a browser starts once.
"""

from __future__ import annotations

import glob
import json
import os
import queue
import shutil
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.support.browser import CHROMIUMS, Made, serve

TIMEOUT_S = 60  # for a page
REPORT = """<script type="module">
const report = await Promise.resolve(window.report).catch((error) => ({ failed: String(error) }));
const answer = await fetch("/report", { method: "POST", body: JSON.stringify(report ?? null) });
location = await answer.text();
</script>"""


@dataclass(frozen=True)
class Browser:
    """One of the three. Any of its programs will do, names or patterns of paths; `{}` is a folder for its files."""

    name: str
    programs: tuple[str, ...]
    options: tuple[str, ...]
    packages: str  # of Debian, in which all of it is
    needs: tuple[str, ...] = ()  # patterns of files
    screen: bool = False  # it needs one
    preferences: str = ""  # of Firefox

    @property
    def program(self) -> str | None:
        found = (shutil.which(name) or next(iter(glob.glob(name)), None) for name in self.programs)
        return next((path for path in found if path), None)

    def missing(self) -> str:
        """Why it is not played here, and what would change that; nothing: it is."""
        lacking = [] if self.program else [self.programs[0]]
        lacking += [need for need in self.needs if not (shutil.which(need) or glob.glob(need))]
        return f"{self.name}: not here: {', '.join(lacking)} (apt-get install {self.packages})" if lacking else ""

    @contextmanager
    def start(self, *arguments: str) -> Iterator[subprocess.Popen[str]]:
        """Run it, with a folder of its own and what it says as text, until the end of the block."""
        assert self.program
        with TemporaryDirectory(ignore_cleanup_errors=True) as folder, _screen(self.screen) as screen:
            Path(folder, "user.js").write_text(self.preferences)
            own = {name: value for name, value in os.environ.items() if not name.startswith("XDG_")}
            own |= {"HOME": folder} | screen
            command = [self.program, *(option.format(folder) for option in self.options), *arguments]
            out, err = subprocess.PIPE, subprocess.DEVNULL
            process = subprocess.Popen(command, env=own, start_new_session=True, stdout=out, stderr=err, text=True)
            try:
                yield process
            finally:
                os.killpg(process.pid, signal.SIGKILL)  # it has no children outside of its session
                process.communicate()

    def version(self) -> str:
        with self.start("--version") as process:
            assert process.stdout
            return process.stdout.readline().strip()


@contextmanager
def _screen(wanted: bool) -> Iterator[dict[str, str]]:
    if not wanted:
        yield {}
        return
    told, tell = os.pipe()
    with subprocess.Popen(["Xvfb", "-displayfd", f"{tell}", "-nolisten", "tcp"], pass_fds=[tell]) as process:
        os.close(tell)
        try:
            with os.fdopen(told) as number:
                yield {"DISPLAY": f":{number.readline().strip()}"}
        finally:  # or the block would wait for it for ever
            process.terminate()


CHROMIUM = (
    *("--headless", "--no-sandbox", "--user-data-dir={}", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--autoplay-policy=no-user-gesture-required"),
)
PREFERENCES = """user_pref("media.autoplay.default", 0); user_pref("media.autoplay.blocking_policy", 0);
user_pref("media.cubeb.force_mock_context", true);"""  # the last one: of a machine without loudspeakers
GSTREAMER = tuple(f"/usr/lib/*/gstreamer-1.0/libgst{name}.so" for name in ("libav", "videoparsersbad"))
WEBKIT = "webkit2gtk-driver xvfb libgl1-mesa-dri libegl1 gstreamer1.0-libav gstreamer1.0-plugins-bad"
BROWSERS = (
    Browser("Chromium", CHROMIUMS, CHROMIUM, "chromium"),
    Browser("Firefox", ("firefox-esr", "firefox"), ("--profile", "{}"),
            "firefox-esr ffmpeg xvfb libgl1-mesa-dri libegl1", ("Xvfb", "/usr/lib/*/libavcodec.so.*"),
            screen=True,  # without one it has no WebGL
            preferences=PREFERENCES),
    Browser("WebKitGTK", ("/usr/lib/*/webkit2gtk-4.*/MiniBrowser",),
            ("--autoplay-policy=allow",),  # without a touch, of which it needs none then
            WEBKIT, ("Xvfb", *GSTREAMER), screen=True),
)  # fmt: skip


def play(
    browser: Browser, pages: Sequence[str], folders: Mapping[str, Path], made: Mapping[str, Made]
) -> tuple[list[Any], list[list[str]]]:
    """What pages report, which a browser opens one after another, and the paths that each asked for.

    Pages end in REPORT; paths, `folders` and `made` are those of `serve`.
    """
    came: queue.Queue[bytes] = queue.Queue()
    following = iter(pages[1:])

    def told(body: bytes) -> bytes:
        came.put(body)
        return next(following, "about:blank").encode()

    with serve(folders, made, told) as site, browser.start(site.url + pages[0]):
        reports = []
        for page in pages:
            try:
                reports.append(json.loads(came.get(timeout=TIMEOUT_S)))
            except queue.Empty:
                raise AssertionError(f"{browser.name}: no report of {page} after {TIMEOUT_S} s") from None
        asked: list[list[str]] = [[]]
        for path, _ in site.answers:
            asked[-1].append(path)
            if path == "/report":
                asked.append([])
    return reports, asked[: len(pages)]
