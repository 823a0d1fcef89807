"""What spark and PlayCanvas lose of our pictures: PSNR of what the adapters draw, and what a frame costs.

A scene is one that is encoded, a package, or ball-0 … ball-3: random Gaussians with SH of that degree. Its Gaussians go
to both engines in headless Chromium (web/test/pages/engines.ts) and to the CPU renderer, with the same four cameras:
three places (of the viewing region), and the first one again at CLOSE of the distance to its focus. Pictures are
compared at 8 bits, and stay in the folder, ours below theirs. "default" is an engine as it comes, "tuned" as the
adapters set it.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
from numpy.typing import NDArray

from airgs_codec import Gaussians, decode, open_package
from airgs_codec.media.image import write_png
from airgs_codec.media.metrics import mse, psnr
from airgs_codec.render import Camera, look_at, render
from airgs_codec.scene.camera import with_near_planes
from airgs_codec.scene.gaussians import SH_REST
from tools.lab import Lab, Page, Row, Section, Table, setting
from tools.lab.made import encoded, name_of
from tools.lab.serving import served_folder

WEB = Path(__file__).parents[3] / "web"
BALL = "ball-"  # and the degree
CLOSE = 0.4  # of the distance to the focus
BALL_VIEWS = ((0.0, 0.6, -4.0), (3.5, -0.8, 2.0), (-3.2, 0.5, 2.4))
BALL_FOV = 60.0  # degrees
ENGINES = {"spark": "spark", "PlayCanvas": "playcanvas"}  # by their names
VARIANTS = ("default", "tuned")
COLUMNS = {
    "scene": ("scene", ""), "engine": ("engine", ""), "tuned": ("lowest of three places, dB", ".1f"),
    "tuned_close": ("close, dB", ".1f"), "default": ("as it comes, lowest of three", ".1f"),
}  # fmt: skip
PAGE = '<!doctype html><link rel="icon" href="data:," /><body><script type="module" src="engines.js"></script>'

Picture = NDArray[np.uint8]  # (H, W, 3)


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = setting(("ball-0", "ball-3"), "balls, packages or scenes, SCENE[=VIEWS]")
    rows: int = setting(10_000, "Gaussians of a ball")
    size: int = setting(512, "of a picture, pixels")
    frame: int = setting(3, "of a package")


def run(options: Options, lab: Lab) -> Page:
    subprocess.run(["node", WEB / "scripts/pages.mjs"], check=True)
    rows: list[Row] = []
    for name in options.scenes:
        place = name if name.startswith(BALL) else str(encoded(name, lab.folder))
        rows += measure(name_of(name), read_scene(place, options.rows, options.frame), options.size, lab.folder)
    how = f"{versions()}, SwiftShader; {options.size} pixels wide."
    return Page([Section("", tables=[Table("engines", rows, COLUMNS)])], how)


def measure(name: str, scene: Scene, size: int, keep: Path) -> Iterator[Row]:
    """A row for each engine, of PSNR in dB: the lowest of three places and the close one, in each variant."""
    truth = [np.round(render(scene.gaussians, c).rgb.clip(0, 1) * 255).astype(np.uint8) for c in scene.cameras(size)]
    with tempfile.TemporaryDirectory() as folder, served_folder(Path(folder)) as url:
        write_page(Path(folder), scene, size)
        for engine in ENGINES:
            row: Row = {"scene": name, "engine": engine}
            for variant in VARIANTS:
                pictures = drawn(url, ENGINES[engine], variant, size)
                sheet = np.concatenate([np.concatenate(line, axis=1) for line in (pictures, truth)])
                write_png(keep / f"{name}-{engine}-{variant}.png", sheet)
                pairs = (np.divide(pair, 255, dtype=np.float32) for pair in zip(pictures, truth, strict=True))
                *places, close = (psnr(mse(*pair)) for pair in pairs)
                row |= {variant: min(places), f"{variant}_close": close}
            yield row


def versions() -> str:
    names = ("three", "@sparkjsdev/spark", "playcanvas")
    read = {name: json.loads((WEB / "node_modules" / name / "package.json").read_text())["version"] for name in names}
    return ", ".join(f"{name} {version}" for name, version in read.items())


@dataclass(frozen=True, slots=True)
class View:
    """Where a camera is, what it looks at and what is up, world units."""

    position: list[float]
    focus: list[float]
    up: list[float]

    def closer(self) -> View:
        position, focus = np.array(self.position), np.array(self.focus)
        return View((focus + CLOSE * (position - focus)).tolist(), self.focus, self.up)

    def camera(self, size: int, fov_y: float) -> Camera:
        """The camera of a square picture; `fov_y` in degrees."""
        at = (np.array(a) for a in (self.position, self.focus, self.up))
        return look_at(*at, size=size, fov_y=float(np.radians(fov_y)), name="view")


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    gaussians: Gaussians
    views: list[View]
    fov_y: float  # degrees

    def cameras(self, size: int) -> list[Camera]:
        return with_near_planes([view.camera(size, self.fov_y) for view in self.views], self.gaussians)


def read_scene(name: str, rows: int, frame: int) -> Scene:
    if name.startswith(BALL):
        views = [View(list(position), [0.0, 0.0, 0.0], [0.0, -1.0, 0.0]) for position in BALL_VIEWS]
        return Scene(ball(rows, int(name.removeprefix(BALL))), [*views, views[0].closer()], BALL_FOV)
    package = open_package(name)
    region = package.manifest.region
    chosen = (region.places[i * len(region.places) // 3] for i in range(3))
    views = [View(list(p.position), list(p.focus), list(p.up)) for p in chosen]
    return Scene(decode(package, frame), [*views, views[0].closer()], region.fov_y)


def ball(rows: int, degree: int) -> Gaussians:
    rng = np.random.default_rng(0)
    arrays = (
        rng.normal(size=(rows, 3)) * 0.5,
        rng.normal(size=(rows, 4)),
        np.log(0.6 / rows ** (1 / 3)) + rng.normal(size=(rows, 3)) * 0.4,
        rng.normal(size=rows) * 2,
        rng.normal(size=(rows, 3)) * 0.6,
        rng.normal(size=(rows, SH_REST[degree], 3)) * 0.1,
    )
    return Gaussians(*(a.astype(np.float32) for a in arrays))


def columns(g: Gaussians) -> bytes:
    """The arrays of `Gaussians` in web/src/format/types.ts, one after the other."""
    quaternions = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    colours = np.concatenate([g.sh_dc[:, None], g.sh_rest], axis=1)
    arrays = (g.means, quaternions, g.log_scales, g.opacities(), colours)
    return b"".join(np.ascontiguousarray(a, "<f4").tobytes() for a in arrays)


def write_page(folder: Path, scene: Scene, size: int) -> None:
    g = scene.gaussians
    header = {"rows": len(g), "channels": 3 * (1 + g.sh_rest.shape[1]), "size": size, "fov_y": scene.fov_y}
    header |= {"near": scene.cameras(size)[0].near, "views": [asdict(v) for v in scene.views]}
    (folder / "views.json").write_text(json.dumps(header))
    (folder / "rows.bin").write_bytes(columns(g))
    (folder / "page.html").write_text(PAGE)
    shutil.copy(WEB / "out/pages/engines.js", folder)


def drawn(url: str, engine: str, variant: str, size: int) -> list[Picture]:
    """The pictures that an engine draws of the scene at `url`."""
    query = urlencode({"scene": ".", "engine": engine, "variant": variant})
    environment = os.environ | {"CHROMIUM": os.environ.get("CHROMIUM") or shutil.which("chromium") or ""}
    asked = json.dumps({"url": f"{url}/page.html?{query}", "script": None})
    command = ["node", str(WEB / "test/open.mjs")]
    done = subprocess.run(command, input=f"{asked}\n", capture_output=True, text=True, check=True, env=environment)
    seen = json.loads(done.stdout)
    if seen["report"] is None:
        raise RuntimeError(f"{engine}, {variant}: no pictures: {seen['failed']}")
    pictures = [np.frombuffer(base64.b64decode(p), np.uint8) for p in seen["report"]["pictures"]]
    return [p.reshape(size, size, 4)[..., :3] for p in pictures]
