"""Pages that tests open: the player that is shipped, scripts of web/test/pages, and one in the place of the player."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest
from numpy.typing import NDArray

from airgs_codec.media.h264 import open_segment
from airgs_codec.serve import pages
from tests.faces import Camera, Package, before_background, content_policy, decode, mse, open_package, psnr, render
from tests.support.browser import WEB, Answer, Made, build_pages, serve, visit
from tests.support.digests import sloped_files
from tests.support.paths import GOLDEN, VALID

SHIPPED = pages.PAGE_FOLDER
LEAST_DB = 55  # of pictures of 8 bits
Folders = Mapping[str, Path]
Answers = Mapping[str, Made]
Task = tuple[str, dict[str, Any]]
PACKAGES = {"golden": GOLDEN, "valid": VALID}
PICTURED = (  # folder/package
    *("golden/fox", "golden/fox-fine", "golden/room", "valid/inter", "valid/slopes", "valid/moving"),
    *("valid/one-gaussian", "valid/paged", "valid/two-groups-sh1"),
)
INLINE = "document.title = 'ready';"
FILES = {  # in the place of the player that web/ builds, so that tests of servers and sites need no Node
    "player.html": f'<!doctype html><script type="module" src="airgs-player.js"></script><script>{INLINE}</script>',
    "airgs-player.js": "customElements.define('airgs-player', class extends HTMLElement {});\n",
    "airgs-vr.js": "export const enter = () => {};\n",
    "airgs-more.js": "export const readCameraPath = () => {};\n",
    "airgs-sound.js": "export class Sound {}\n",
    "airgs.js": "export const open = () => {};\n",
    "airgs-frames.js": "export const openFrames = () => {};\n",
    "airgs-list.js": "export {};\n",
}


def put_page(folder: Path, patch: pytest.MonkeyPatch) -> Path:
    """Write a page into `folder`, and let the server and the export take it for the player."""
    folder.mkdir(exist_ok=True)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    patch.setattr(pages, "PAGE_FOLDER", folder)
    return folder


def shipped_page(script: str, policy: bool = True) -> Answer:
    """player.html with a script of web/test/pages before its own, under the policy that the server sends with it."""
    tag = f'<head><script type="module" src="/web/out/pages/{script}.js"></script>'
    page = (SHIPPED / "player.html").read_text().replace("<head>", tag)
    return Answer(page.encode(), headers={"Content-Security-Policy": content_policy(page)} if policy else {})


def asking(**asked: object) -> str:
    """web/test/pages/shipped.ts as a script that runs on a page before those of its own, with what it is asked."""
    build_pages()
    return f"globalThis.asked = {json.dumps(asked)};\n{(WEB / 'out' / 'pages' / 'shipped.js').read_text()}"


def script_page(name: str) -> bytes:
    """A page with nothing but the script web/test/pages/NAME.ts."""
    icon = '<link rel="icon" href="data:,">'
    script = f'<script type="module" src="/web/out/pages/{name}.js"></script>'
    return f'<!doctype html><meta charset="utf-8">{icon}<body>{script}'.encode()


def look(
    name: str, folders: Folders, made: Answers | None = None, known: tuple[str, ...] = (), **query: object
) -> tuple[Any, list[str]]:
    """What a script of web/test/pages reports, and the paths that it asked for; it complains only of what is known."""
    build_pages()
    with serve({"web": WEB, **folders}, {"/page.html": script_page(name), **(made or {})}) as site:
        seen = visit(f"{site.url}/page.html?{urlencode(query)}")
    assert seen.complaints(known) == []
    return seen.report, [path for path, _ in site.answers]


def do_tasks(steps: Mapping[str, Task], made: Answers | None = None, folders: Folders | None = None) -> Any:
    """What web/test/pages/media.ts reports of steps, name -> (task, arguments); Chromium may complain of faults."""
    build_pages()
    plan = json.dumps([{"name": name, "task": task} | arguments for name, (task, arguments) in steps.items()])
    given = {"/page.html": script_page("media"), "/plan.json": plan.encode(), **(made or {})}
    with serve({**PACKAGES, "web": WEB, **(folders or {})}, given) as site:
        seen = visit(f"{site.url}/page.html")
    assert [line for line in seen.failed if "net::" not in line] == []
    assert seen.report.keys() == steps.keys()
    return seen.report


def open_pictured(name: str) -> Package:
    folder, _, rest = name.partition("/")
    return open_package(PACKAGES[folder] / rest)


def check_luma(name: str, found: Mapping[str, list[str]]) -> None:
    """Digests of pictures of files, all of one page and then all of the next, are those of what Python decodes."""
    package = open_pictured(name)
    m = package.manifest
    sloped = sloped_files(m)
    assert bool(sloped) == (name in ("valid/slopes", "valid/moving"))  # those with slopes
    paths = [path for group in range(len(m.groups)) for path in m.group_files(group)]
    assert set(found) == {path for path in paths if path.endswith(".m4s")}
    for path, digests in found.items():
        _, pictures = open_segment(package.read(path), path)
        expected = [sha256(picture.tobytes()).hexdigest() for picture in pictures]
        assert digests == expected[path in sloped :], path  # slopes are no frame


def pixels_of(picture: str, width: int, height: int) -> NDArray[np.uint8]:
    return np.frombuffer(base64.b64decode(picture), np.uint8).reshape(height, width, 4)[..., :3]


def decibels(pixels: NDArray[np.uint8], truth: NDArray[np.float32]) -> float:
    rounded = np.round(255 * truth.clip(0, 1)) / np.float32(255)
    assert rounded.std() > 0.05
    return psnr(mse((pixels / 255).astype(np.float32), rounded.astype(np.float32)))


def check_sought(package: Package, report: Any, rung: tuple[int, int], frames: Sequence[int]) -> None:
    """What player.ts shows of frames in a rung, (keyframe quality, level), is what the CPU renderer draws."""
    assert report["paused"] and [seen["frame"] for seen in report["pictures"]] == frames
    lens = report["camera"]
    numbers = {k: lens[k] for k in ("width", "height", "fx", "fy", "cx", "cy", "near")}
    page = Camera("page", world_to_camera=np.array(lens["worldToCamera"]).reshape(4, 4), **numbers)
    [camera] = before_background(package.manifest.region, [page])
    for seen in report["pictures"]:
        shown = decode(package, seen["frame"], level=rung[1], keyframe_quality=rung[0])
        pixels = pixels_of(seen["picture"], camera.width, camera.height)
        assert decibels(pixels, render(shown, camera).rgb) >= LEAST_DB


def off_s(heard: Sequence[dict[str, float]], seconds: float) -> float:
    """How far the sound of a loop of so many seconds was from pictures: the median, as pages may be held up."""
    off = np.array([one["sound"] - one["picture"] for one in heard])
    return float(np.median(np.abs((off + seconds / 2) % seconds - seconds / 2)))  # at the end, one may have begun anew
