"""Write docs/session.gif: a simulated session on the embedded scene; left the screen, right the link and the rungs.

    python -m tools.make_film [-o docs/session.gif]

The scene is encoded at 12 frames a second, half its speed, so that a viewer of the film can follow it, and the measured
rates of the LTE trace beside it are scaled so that the top rung does not always fit. The viewer walks through the
viewing region of the package. H x W pixels; pictures are (H, W, 3) RGB of 8 bits.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import airgs_codec as airgs
from airgs_codec.media.image import label, to_bytes
from airgs_codec.package.package import Package
from airgs_codec.play.report.film import screen_frames
from airgs_codec.play.report.map import Viewer
from airgs_codec.play.session import SessionLog
from airgs_codec.play.trace import Trace
from airgs_codec.render import render

REPOSITORY = Path(__file__).parent.parent
SCENE = REPOSITORY / "tests" / "data" / "fox"
FPS = 12
LOOPS = 10  # of the ten frames: about eight seconds
BUFFER_S = 1.5  # short, so that the choices follow the link
OFFSET_S, SCALE = 278.0, 0.7  # of the trace: a stretch where the rate falls and comes back
CROP = slice(40, 300)  # rows of the 320 that are shown
COLOURS = 64  # of the palette


def play(folder: Path) -> tuple[Package, SessionLog, Trace]:
    """Encode the scene into `folder` and play it over its trace."""
    sequence = airgs.open_sequence(SCENE, fps=Fraction(FPS))
    airgs.encode(sequence, folder / "fox.airgs")
    package = airgs.open_package(folder / "fox.airgs")
    trace = airgs.open_trace(SCENE / "trace.csv").cut(OFFSET_S, SCALE)
    log = airgs.simulate(package, trace, "robust-mpc", airgs.SessionSettings(buffer_s=BUFFER_S, loops=LOOPS))
    return package, log, trace


def screens(package: Package, log: SessionLog, viewer: Viewer) -> Iterable[NDArray[np.uint8]]:
    """Yield what is on the screen at every tick, with the name and the quality of its rung."""
    seen = [0] * len(log.shown)
    for tick, (gaussians, entry) in enumerate(screen_frames(package, log)):
        shown = log.shown[entry]
        waits = seen[entry] == shown.frames
        seen[entry] += not waits
        assert gaussians is not None and shown.rung is not None, "nothing is lost on this link"
        text = "waiting for data" if waits else f"{log.offers.names[shown.rung]}   {shown.psnr:.1f} dB"
        picture = label(to_bytes(render(gaussians, viewer.cameras[tick]).rgb)[CROP], text)
        yield label(picture, viewer.caption(tick), 1) if viewer.caption(tick) else picture


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
    """The chart of a session in so many pixels."""
    start, ticks = log.shown[0].start_s, len(log.screen_ticks)
    stop = start + ticks / FPS
    figure, (rate, rungs) = plt.subplots(
        2, 1, figsize=(width / 100, height / 100), dpi=100, sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    seconds = np.linspace(start, stop, 400)
    rate.fill_between(seconds, [trace.rate_at(s) / 1e6 for s in seconds], step="mid", color="#9db8d6")
    rate.set(xlim=(start, stop), ylim=(0, None))
    rate.set_title("the link, Mbit/s", fontsize=8, loc="left")
    qualities = [shown.psnr or 0.0 for shown in log.shown]
    shade = plt.Normalize(min(qualities), max(qualities))
    for shown, quality in zip(log.shown, qualities, strict=True):
        colour = plt.get_cmap("RdYlGn")(shade(quality))
        rungs.axvspan(shown.start_s, shown.start_s + shown.frames / FPS, color=colour, linewidth=0)
    rungs.set(yticks=[], xlabel="seconds")
    rungs.set_title(
        f"on the screen: {min(qualities):.1f} dB (red) to {max(qualities):.1f} dB (green)", fontsize=8, loc="left"
    )
    for axes in (rate, rungs):
        axes.tick_params(labelsize=7)
    rungs.xaxis.label.set_size(7)
    data = io.BytesIO()
    figure.savefig(data, format="rgba")
    first, last = (float(rungs.transData.transform((s, 0))[0]) for s in (start, stop))
    rows = slice(round(height - rate.bbox.y1), round(height - rungs.bbox.y0))
    plt.close(figure)
    picture = np.frombuffer(data.getvalue(), np.uint8).reshape(height, width, 4)[..., :3]
    return Chart(picture, first, last, rows)


def write_gif(path: Path, pictures: Sequence[NDArray[np.uint8]]) -> None:
    """An endless GIF at FPS with one palette for all pictures, without dithering: what stands still costs nothing."""
    height, width = pictures[0].shape[:2]
    graph = av.filter.Graph()
    source = graph.add_buffer(width=width, height=height, format=av.VideoFormat("rgb24"), time_base=Fraction(1, FPS))
    split, palette = graph.add("split"), graph.add("palettegen", f"max_colors={COLOURS}:stats_mode=full")
    use, sink = graph.add("paletteuse", "dither=none:diff_mode=rectangle"), graph.add("buffersink")
    source.link_to(split)
    split.link_to(palette, 0)
    split.link_to(use, 1, 0)
    palette.link_to(use, 0, 1)
    use.link_to(sink)
    graph.configure()
    for number, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame.pts, frame.time_base = number, Fraction(1, FPS)
        source.push(frame)
    source.push(None)
    with av.open(str(path), "w", format="gif") as container:
        stream = container.add_stream("gif", rate=FPS, width=width, height=height, pix_fmt="pal8")
        for _ in pictures:
            container.mux(stream.encode(cast(av.VideoFrame, sink.pull())))
        container.mux(stream.encode(None))


def main() -> None:
    """Make the film."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=REPOSITORY / "docs" / "session.gif")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        package, log, trace = play(Path(folder))
        shots = list(screens(package, log, Viewer.of(log)))
    chart = draw_chart(log, trace, *shots[0].shape[:2])
    shares = np.linspace(0, 1, len(shots))
    pictures = [np.hstack([shot, chart.at(float(share))]) for shot, share in zip(shots, shares, strict=True)]
    write_gif(args.output, pictures)
    print(f"{args.output}: {len(pictures)} pictures, {args.output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
