"""What a training run came to: an answer in words, curves and pictures of it, and a page that shows them.

PSNR is the mean over views of each view's PSNR in dB, and over frames in what is said of all of them. H x W pixels.
"""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import BLUE, GREY, ORANGE, RED, Page, Picture, report_folder
from airgs_codec.media.image import label, to_bytes, write_png
from airgs_codec.media.metrics import psnr
from airgs_codec.progress import about
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.trainer.data.pictures import Pictures, View
from airgs_codec.trainer.fit.losses import PSNR_DEFINITION
from airgs_codec.trainer.frames import frame_before
from airgs_codec.trainer.record import FrameRecord, Model, Record

RELOADED_S = 15  # seconds until a browser loads the page of a run that goes on again
ERROR_GAIN = 5  # of the error maps
FAR_DB = 3.0  # under the mean, or under the training views, from which something is wrong
MATCHED_DB = 1.0  # by which an exposure that is matched shows more, from which cameras differ
DRIFT_DB = 1.0  # that the last third of the frames shows less than the first


def write_report(model: Model, pictures: Pictures, directory: Path, renderer: Renderer = CPU) -> Path:
    """Write index.html with its charts and the pictures of two frames into a directory, and give its path.

    Raises ConfigError when they cannot be written, or without matplotlib.
    """
    record = model.record
    first, worst = frames_to_show(record.frames)
    seen = sorted(_seen(model, pictures, worst, renderer), key=lambda found: found[0])
    answer = training_answer(record, {view.camera.name: db for db, view in seen})
    psnr_words = f"Each frame; red: keyframes. PSNR is the {PSNR_DEFINITION}."
    shown = [
        Picture(psnr_words, partial(_psnr, record)),
        Picture("Seconds of each frame; red: keyframes.", partial(_seconds, record)),
    ]
    with report_folder(directory):
        for frame, view, words in ((worst, seen[0][1], "The worst frame"), (first, None, "Another one")):
            panels, name = compare(model, pictures, frame, renderer, view), f"frame-{frame:06d}.png"
            write_png(directory / name, panels)
            words += f": filmed, trained, and {ERROR_GAIN} times the error."
            shown.append(Picture(words, name=name, panels=3, shape=panels.shape))
        settings = f"<p><code>{html.escape(str(record.settings))}</code></p>"
        more = {"Settings": settings}
        title, again = f"Training of {model.folder.name}", None if record.complete else RELOADED_S
        return Page(title, answer, shown, more, again).write(directory / "index.html")


def compare(
    model: Model, pictures: Pictures, frame: int, renderer: Renderer = CPU, view: View | None = None
) -> NDArray[np.uint8]:
    """Picture, rendering and error map side by side, (H, 3 W, 3), of a view of a frame.

    `view`: None for the first one that is held out, or where none is, the first training view.
    """
    view = view or _views(pictures, frame)[0]
    rendered = _rendered(model, frame, view, renderer)
    error = np.abs(rendered - view.target.rgb).mean(axis=2) * ERROR_GAIN
    panels = [
        label(to_bytes(view.target.rgb), f"frame {frame} {view.camera.name} ({view.camera.split})"),
        label(to_bytes(rendered), "trained"),
        label(_heat(error), f"error x {ERROR_GAIN}"),
    ]
    return np.concatenate(panels, axis=1)


def _views(pictures: Pictures, frame: int) -> Sequence[View]:
    """The held-out views of a frame; where there are none, the training views."""
    return pictures.held_out(frame) or pictures.train(frame)


def _rendered(model: Model, frame: int, view: View, renderer: Renderer) -> NDArray[np.float32]:
    """(H, W, 3) of [0, 1], what a view shows of a frame when it was taken."""
    g = frame_before(model, frame + 1).at(view.after) if view.after else model.read(frame)
    return np.clip(renderer.render(g, view.camera).rgb, 0, 1)


def _seen(model: Model, pictures: Pictures, frame: int, renderer: Renderer) -> Iterator[tuple[float, View]]:
    for view in _views(pictures, frame):
        yield psnr(float(np.mean((_rendered(model, frame, view, renderer) - view.target.rgb) ** 2))), view


def frames_to_show(records: Sequence[FrameRecord]) -> tuple[int, int]:
    """The first frame, or where that is the worst one the last, and the worst: of lowest PSNR in what is held out, or
    in training views.
    """
    worst = min(records, key=_shown_db).frame
    return next((r.frame for r in (records[0], records[-1]) if r.frame != worst), worst), worst


def _shown_db(r: FrameRecord) -> float:
    return r.psnr if r.held_out_psnr is None else r.held_out_psnr


def training_answer(record: Record, cameras: Mapping[str, float]) -> dict[str, str]:
    """What a run comes to in whole sentences; `cameras`: PSNR in dB of the worst frame in each, the worst first."""
    frames, (first, *others) = record.frames, record.frames
    held_out = [r.held_out_psnr for r in frames if r.held_out_psnr is not None]  # not of frames that they lack
    shown, third = held_out or [r.psnr for r in frames], len(held_out or frames) // 3
    trained, mean = float(np.mean([r.psnr for r in frames])), float(np.mean(shown))
    good, change = [], []
    if not record.complete:
        left = (record.total - len(frames)) * float(np.mean([r.seconds for r in others])) if others else 0.0
        time = f"; the others take {about(left)}" if others else ""
        good.append(f"{len(frames)} of {record.total} frames are trained{time}. This page fills.")
    if first.held_out_psnr is None:
        good.append(f"The cameras trained on see {trained:.1f} dB; none is held out, so what others see is not known.")
    else:
        good.append(f"Cameras that were held out see {mean:.1f} dB, those trained on {trained:.1f} dB.")
    of = f" of a budget of {limit:,}" if (limit := record.settings.get("budget")) else ""
    good.append(f"The model has {first.gaussians:,} Gaussians{of} and took {about(sum(r.seconds for r in frames))}.")
    worst, (camera, db) = min(frames, key=_shown_db), next(iter(cameras.items()))
    far = ", far below the mean" if _shown_db(worst) < mean - FAR_DB else ""
    wrong = [
        f"Frame {worst.frame} is the worst with {_shown_db(worst):.1f} dB{far}, camera {camera} in it with {db:.1f}."
    ]
    if others and others[0].kind == "frame" and others[0].psnr > first.psnr:  # fitted on, though the scene moved
        more = f"The second frame shows {others[0].psnr - first.psnr:.2f} dB more than the first"
        change.append(f"{more}, whose fit was not done: more --iterations pay, or --effort high.")
    if (gap := trained - mean) > FAR_DB:
        wrong.append(f"Held-out cameras see {gap:.1f} dB less than those trained on: what no camera sees is guessed.")
        change.append("More cameras, or fewer Gaussians (--budget), lessen what is guessed between cameras.")
    if (exposure := float(np.mean([(r.held_out_matched or 0) - (r.held_out_psnr or 0) for r in frames]))) > MATCHED_DB:
        wrong.append(f"{exposure:.1f} dB of the error are the exposure of cameras alone.")
        change.append("Try --match-exposure on.")
    if third and (drift := float(np.mean(shown[:third]) - np.mean(shown[-third:]))) > DRIFT_DB:
        wrong.append(f"The last third of the frames shows {drift:.1f} dB less than the first.")
        change.append(f"Begin new groups earlier: --max-drop {record.settings['max_drop_db'] / 2:g}.")
    wrong += [f"Warning: {warning}." for warning in record.warnings()]
    tried = sum(r.kind == "frame" and r.rejected_psnr is not None for r in frames)
    return {
        "good": " ".join(good),
        "wrong": " ".join(wrong),
        "useless": f"{tried} keyframes were fitted and not taken: a larger --max-drop tries fewer." if tried else "",
        "change": " ".join(change) or "Nothing: airgs-encode takes the model as it is.",
    }


def _over_frames(record: Record, axis: Any, name: str) -> None:
    for r in record.frames:
        if r.kind == "key":
            axis.axvline(r.frame, color=RED, alpha=0.4, linewidth=1)
    axis.set(xlabel="frame", ylabel=name, xlim=(-0.5, max(1, record.total) - 0.5))
    axis.xaxis.get_major_locator().set_params(integer=True)


def _psnr(record: Record, axis: Any) -> None:
    records = record.frames
    frames = [r.frame for r in records]
    axis.plot(frames, [r.psnr for r in records], "o-", ms=3, color=BLUE, label="trained on")
    if records[0].held_out_psnr is not None:
        axis.plot(frames, [r.held_out_psnr for r in records], "o-", ms=3, color=ORANGE, label="held out")
    rejected = [r for r in records if r.rejected_psnr is not None]
    if rejected:
        drawn = [r.rejected_psnr for r in rejected]
        axis.plot([r.frame for r in rejected], drawn, "x", color=RED, label="fit not taken")
    _over_frames(record, axis, "PSNR, dB")
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=3, fontsize=8, frameon=False)


def _seconds(record: Record, axis: Any) -> None:
    axis.bar([r.frame for r in record.frames], [r.seconds for r in record.frames], color=GREY)
    _over_frames(record, axis, "seconds")


def _heat(error: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(H, W, 3) black, red, yellow, white for errors (H, W) from 0 to 1; larger ones are white too."""
    e = np.clip(error, 0, 1)[..., None]
    return to_bytes(np.clip(3 * e - np.array([0.0, 1.0, 2.0]), 0, 1))
