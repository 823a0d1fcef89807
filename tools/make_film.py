"""Write docs/session.webp: a simulated session on the talking head; above the screen, below the link and the rungs.

    python -m tools.make_film [-o docs/session.webp]

The measured rates of an LTE trace are scaled so that the top rung does not always fit. The viewer walks through the
viewing region of the package. Every second frame is shown. H x W pixels; pictures are (H, W, 3) RGB of 8 bits.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image

import airgs_codec as airgs
from airgs_codec.media.image import label, to_bytes
from airgs_codec.package.package import Package
from airgs_codec.play.film import screen_frames, walk
from airgs_codec.play.session import SessionLog
from airgs_codec.play.trace import Trace
from airgs_codec.render import Camera, render
from airgs_codec.scene.camera import with_pixels

REPOSITORY = Path(__file__).parent.parent
HEAD = REPOSITORY / "manifests" / "showcase" / "head.airgs"
TRACE = REPOSITORY / "tests" / "data" / "fox" / "trace.csv"
EVERY, FPS = 2, 15  # frames of the package, and pictures a second
WIDTH, HEIGHT, CHART_HEIGHT = 720, 405, 130
BUFFER_S = 2.0  # short, so that the choices follow the link
OFFSET_S, SCALE = 120.0, 0.34  # of the trace: a stretch where the rate falls and comes back
QUALITY = 70  # of WebP


def play() -> tuple[Package, SessionLog, Trace]:
    package = airgs.open_package(HEAD)
    trace = airgs.Trace.open(TRACE).cut(OFFSET_S, SCALE)
    log = airgs.simulate(package, trace, "robust-mpc", airgs.SessionSettings(buffer_s=BUFFER_S, loops=1))
    return package, log, trace


def screens(package: Package, log: SessionLog, cameras: Sequence[Camera]) -> Iterable[NDArray[np.uint8]]:
    """Yield what is on the screen at every tick, with the name and the quality of its rung."""
    seen = [0] * len(log.shown)
    for tick, (gaussians, entry) in enumerate(screen_frames(package, log)):
        shown = log.shown[entry]
        waits = seen[entry] == shown.frames
        seen[entry] += not waits
        if tick % EVERY:
            continue
        assert gaussians is not None and shown.rung is not None, "nothing is lost on this link"
        text = "waiting for data" if waits else f"{log.offers.names[shown.rung]}   {shown.psnr:.1f} dB"
        camera = with_pixels(cameras[tick], WIDTH, HEIGHT)
        yield label(to_bytes(render(gaussians, camera).rgb), text)


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """(H, W, 3) the link's rate above the rungs on the screen, and where its axes are."""

    picture: NDArray[np.uint8]
    first: float  # column of the first tick
    last: float  # column of the last tick
    rows: slice

    def at(self, share: float) -> NDArray[np.uint8]:
        """A copy with a dark line two pixels wide where this share of the session is over."""
        out = self.picture.copy()
        column = round(self.first + share * (self.last - self.first))
        out[self.rows, column - 1 : column + 1] = (40, 40, 40)
        return out


def draw_chart(log: SessionLog, trace: Trace, height: int, width: int) -> Chart:
    start, ticks = log.shown[0].start_s, len(log.screen_ticks)
    fps = float(log.offers.fps)
    stop = start + ticks / fps
    figure, (rate, rungs) = plt.subplots(
        2, 1, figsize=(width / 100, height / 100), dpi=100, sharex=True, height_ratios=(2, 1), layout="constrained"
    )
    seconds = np.linspace(start, stop, 400)
    rate.fill_between(seconds, [trace.rate_at(s) / 1e6 for s in seconds], step="mid", color="#9db8d6")
    rate.set(xlim=(start, stop), ylim=(0, None))
    rate.set_title("the link, Mbit/s", fontsize=8, loc="left")
    qualities = [shown.psnr or 0.0 for shown in log.shown]
    shade = plt.Normalize(min(qualities), max(qualities))
    for shown, quality in zip(log.shown, qualities, strict=True):
        colour = plt.get_cmap("RdYlGn")(shade(quality))
        rungs.axvspan(shown.start_s, shown.start_s + shown.frames / fps, color=colour, linewidth=0)
    rungs.set(yticks=[])
    rungs.set_title(
        f"on the screen: {min(qualities):.1f} dB (red) to {max(qualities):.1f} dB (green)", fontsize=8, loc="left"
    )
    for axes in (rate, rungs):
        axes.tick_params(labelsize=7)
    data = io.BytesIO()
    figure.savefig(data, format="rgba")
    first, last = (float(rungs.transData.transform((s, 0))[0]) for s in (start, stop))
    rows = slice(round(height - rate.bbox.y1), round(height - rungs.bbox.y0))
    plt.close(figure)
    picture = np.frombuffer(data.getvalue(), np.uint8).reshape(height, width, 4)[..., :3]
    return Chart(picture, first, last, rows)


def write_animation(path: Path, pictures: Sequence[NDArray[np.uint8]]) -> None:
    first, *others = map(Image.fromarray, pictures)
    shown = [round(1000 * (place + 1) / FPS) - round(1000 * place / FPS) for place in range(len(pictures))]
    first.save(path, save_all=True, append_images=others, duration=shown, loop=0, quality=QUALITY, method=4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=REPOSITORY / "docs" / "session.webp")
    args = parser.parse_args()
    package, log, trace = play()
    shots = list(screens(package, log, walk(log)))
    chart = draw_chart(log, trace, CHART_HEIGHT, WIDTH)
    shares = np.linspace(0, 1, len(shots))
    pictures = [np.vstack([shot, chart.at(float(share))]) for shot, share in zip(shots, shares, strict=True)]
    write_animation(args.output, pictures)
    print(f"{args.output}: {len(pictures)} pictures, {args.output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
