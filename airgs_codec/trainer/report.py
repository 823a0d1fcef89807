"""The page of a training run: an answer in words, PSNR of every frame, and pictures of the lowest and the first one.

PSNR is the mean over views of each view's PSNR in dB, and over frames in sentences on all of them. H x W pixels.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import BLUE, ORANGE, RED, Page, PagePicture, answered
from airgs_codec.media.image import contact_sheet, to_bytes, write_png
from airgs_codec.media.metrics import psnr
from airgs_codec.progress import about
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.trainer.data.pictures import ScenePictures, View
from airgs_codec.trainer.fit.losses import PSNR_DEFINITION
from airgs_codec.trainer.frames import frame_before
from airgs_codec.trainer.record import FrameRecord, ModelFolder, Record

ERROR_GAIN = 5  # of the errors that are shown
FAR_DB = 3.0  # under the mean, or under the training views, from which something is wrong


def write_report(model: ModelFolder, pictures: ScenePictures, directory: Path, renderer: Renderer = CPU) -> Path:
    """Write index.html with the answer, a chart, and pictures of the lowest and the first frame; return its path.

    Raises ConfigError when they cannot be written.
    """
    record, camera = model.record, ""
    lowest, first = min(record.frames, key=_shown_db).frame, record.frames[0].frame
    words = f"Each frame; red: keyframes. PSNR is the {PSNR_DEFINITION}."
    shown = [PagePicture("", words, partial(_draw, record))]
    for frame in dict.fromkeys((lowest, first)):
        views = pictures.held_out(frame) or pictures.train(frame)
        seen = {view.camera.name: (view, _rendered(model, frame, view, renderer)) for view in views}
        errors = {name: float(np.mean((rgb - view.target.rgb) ** 2)) for name, (view, rgb) in seen.items()}
        name = max(errors, key=lambda name: errors[name]) if frame == lowest else views[0].camera.name
        camera = camera or f"{name} in it with {psnr(errors[name]):.1f}"
        which = "lowest" if frame == lowest else "first"
        words = f"The {which} frame: filmed, trained, {ERROR_GAIN} times the error."
        shown.append(PagePicture(f"frame-{frame:06d}.png", words, save=partial(_save, frame, *seen[name])))
    sections = answered(training_answer(record, camera), shown)
    return Page(sections, f"Training of {model.folder.name}", None if record.complete else 15).write(directory)


def _rendered(model: ModelFolder, frame: int, view: View, renderer: Renderer) -> NDArray[np.float32]:
    """Draw (H, W, 3) of [0, 1], what a view shows of a frame when it was taken."""
    g = frame_before(model, frame + 1).at(view.after) if view.after else model.read(frame)
    return np.clip(renderer.render(g, view.camera).rgb, 0, 1)


def _save(frame: int, view: View, rendered: NDArray[np.float32], path: Path) -> None:
    error = np.clip(np.abs(rendered - view.target.rgb) * ERROR_GAIN, 0, 1)
    captions = [f"frame {frame} {view.camera.name} ({view.camera.split})", "trained", f"error x {ERROR_GAIN}"]
    write_png(path, contact_sheet([to_bytes(rgb) for rgb in (view.target.rgb, rendered, error)], captions, columns=3))


def _shown_db(r: FrameRecord) -> float:
    return r.psnr if r.held_out_psnr is None else r.held_out_psnr


def training_answer(record: Record, camera: str) -> dict[str, str]:
    """Return sentences on the result of a run; `camera`: which shows least of the lowest frame, and its PSNR."""
    frames, (first, *others) = record.frames, record.frames
    held_out = [r.held_out_psnr for r in frames if r.held_out_psnr is not None]  # a camera may have no picture
    shown, third = held_out or [r.psnr for r in frames], len(held_out or frames) // 3
    trained, mean, lowest = float(np.mean([r.psnr for r in frames])), float(np.mean(shown)), min(frames, key=_shown_db)
    good = f"The cameras trained on see {trained:.1f} dB; none is held out, so what others see is not known."
    if held_out:
        good = f"Cameras that were held out see {mean:.1f} dB, those trained on {trained:.1f} dB."
    if not record.complete:
        left = (record.total - len(frames)) * float(np.mean([r.seconds for r in others])) if others else 0.0
        time = f"; the others take {about(left)}" if others else ""
        good = f"{len(frames)} of {record.total} frames are trained{time}. This page fills. {good}"
    of = f" of a budget of {limit:,}" if (limit := record.settings.get("budget")) else ""
    good += f" The model has {first.gaussians:,} Gaussians{of} and took {about(sum(r.seconds for r in frames))}."
    far = ", far below the mean" if _shown_db(lowest) < mean - FAR_DB else ""
    wrong, change = [f"Frame {lowest.frame} is the lowest with {_shown_db(lowest):.1f} dB{far}, camera {camera}."], []
    exposure = float(np.mean([(r.held_out_matched or 0) - (r.held_out_psnr or 0) for r in frames]))
    drift = float(np.mean(shown[:third]) - np.mean(shown[-third:])) if third else 0.0
    moved = others[0].psnr - first.psnr if others and others[0].kind == "frame" else 0.0
    for holds, words, remedy in (
        (trained - mean > FAR_DB, f"Held-out cameras see {trained - mean:.1f} dB less than those trained on: what no "
         "camera sees is guessed.", "More cameras, or fewer Gaussians (--budget), lessen what is guessed."),
        (exposure > 1, f"{exposure:.1f} dB of the error are the exposure of cameras alone.",
         "Try --match-exposure on."),
        (drift > 1, f"The last third of the frames shows {drift:.1f} dB less than the first.",
         f"Begin new groups earlier: --max-drop {record.settings['max_drop_db'] / 2:g}."),
        (moved > 0, f"The second frame, which only moves the first, shows {moved:.2f} dB more: that was not fitted to "
         "the end.", "More --iterations pay, or --effort high."),
    ):  # fmt: skip
        if holds:
            wrong.append(words)
            change.append(remedy)
    wrong += [f"Warning: {warning}." for warning in record.warnings()]
    advice = " ".join(change) or "Nothing: airgs-encode takes the model as it is."
    return {"good": good, "wrong": " ".join(wrong), "change": advice}


def _draw(record: Record, figure: Any) -> None:
    axis, frames = figure.subplots(), [r.frame for r in record.frames]
    for frame in record.keyframes()[1:]:
        axis.axvline(frame, color=RED, alpha=0.4, linewidth=1)
    for name, form, colour, words in (
        ("psnr", "o-", BLUE, "trained on"),
        ("held_out_psnr", "o-", ORANGE, "held out"),
        ("rejected_psnr", "x", RED, "fit not taken"),
    ):
        values = np.array([getattr(r, name) for r in record.frames], np.float64)
        if np.isfinite(values).any():
            axis.plot(frames, values, form, ms=3, color=colour, label=words)
    axis.set(xlabel="frame", ylabel="PSNR, dB", xlim=(-0.5, max(1, record.total) - 0.5))
    axis.xaxis.get_major_locator().set_params(integer=True)
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=3, frameon=False)
