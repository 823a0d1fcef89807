"""Curves and pictures of a training run, and a page that shows them.

PSNR is the mean over views of each view's PSNR in dB, and over frames in the page's table. H x W pixels.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airgs_codec._report import new_figure, page, save_figure
from airgs_codec.errors import ConfigError
from airgs_codec.jobs.job import Record as Job
from airgs_codec.jobs.report import NAME as JOBS_NAME
from airgs_codec.jobs.report import write_report as write_jobs
from airgs_codec.media.image import label, to_bytes, write_png
from airgs_codec.progress import about
from airgs_codec.render.backend import CPU, Renderer
from airgs_codec.trainer.data.pictures import Pictures
from airgs_codec.trainer.fit.losses import PSNR_DEFINITION
from airgs_codec.trainer.frames import frame_before
from airgs_codec.trainer.record import FrameRecord, Model

_BLUE, _ORANGE, _GREEN, _RED = "#2a6fbb", "#e08a1e", "#3a9a5b", "#c8453b"
RELOADED_S = 15  # seconds until a browser loads the page of a run that goes on again
ERROR_GAIN = 5  # of the error maps


def write_report(
    model: Model, pictures: Pictures, directory: Path, renderer: Renderer = CPU, jobs: Sequence[Job] = ()
) -> Path:
    """Write training.png, frame-*.png and index.html into a directory, and give the path of the page.

    `jobs`: that the run was trained by, of which jobs.html tells; none: it was not trained by jobs. Raises ConfigError
    when they cannot be written, or without matplotlib.
    """
    records = model.record.frames
    try:
        directory.mkdir(parents=True, exist_ok=True)
        plot_curves(records, model.record.total, directory / "training.png")
        shown = {frame: f"frame-{frame:06d}.png" for frame in frames_to_show(records)}
        for frame, name in shown.items():
            write_png(directory / name, compare(model, pictures, frame, renderer))
        path = directory / "index.html"
        if jobs:
            write_jobs(directory / JOBS_NAME, jobs)
        path.write_text(_page(model, shown, JOBS_NAME if jobs else None), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{directory}: cannot write the report: {error}") from error
    return path


def compare(model: Model, pictures: Pictures, frame: int, renderer: Renderer = CPU) -> NDArray[np.uint8]:
    """Picture, rendering and error map side by side, (H, 3 W, 3), of the first held-out view of a frame.

    Where no view is held out, of the first training view.
    """
    view = (pictures.held_out(frame) or pictures.train(frame))[0]
    g = frame_before(model, frame + 1).at(view.after) if view.after else model.read(frame)
    rendered = renderer.render(g, view.camera).rgb
    error = np.abs(np.clip(rendered, 0, 1) - view.target.rgb).mean(axis=2) * ERROR_GAIN
    panels = [
        label(to_bytes(view.target.rgb), f"frame {frame} {view.camera.name} ({view.camera.split})"),
        label(to_bytes(rendered), "trained"),
        label(_heat(error), f"error x {ERROR_GAIN}"),
    ]
    return np.concatenate(panels, axis=1)


def plot_curves(records: Sequence[FrameRecord], total: int, path: Path) -> None:
    """Draw PSNR, count, static updates and seconds over frames, of which there will be `total`, into a picture file.

    Raises ConfigError.
    """
    figure = new_figure(10, 11)
    axes = figure.subplots(4, 1, sharex=True)
    for draw, axis in zip((_psnr, _count, _static, _seconds), axes, strict=True):
        draw(axis, records)
        axis.grid(alpha=0.25)
        for record in records:
            if record.kind == "key":
                axis.axvline(record.frame, color=_RED, alpha=0.4, linewidth=1)
    axes[-1].set(xlabel="frame (red: keyframes)", xlim=(-0.5, max(1, total) - 0.5))
    axes[-1].xaxis.get_major_locator().set_params(integer=True)
    save_figure(figure, path)


def _psnr(axis: Any, records: Sequence[FrameRecord]) -> None:
    frames = [r.frame for r in records]
    axis.plot(frames, [r.psnr for r in records], "o-", ms=3, color=_BLUE, label="training views")
    if records[0].held_out_psnr is not None:
        axis.plot(frames, [r.held_out_psnr for r in records], "o-", ms=3, color=_ORANGE, label="held-out views")
    rejected = [r for r in records if r.rejected_psnr is not None]
    label = "training views, the fit that was not taken" if rejected else None
    axis.plot([r.frame for r in rejected], [r.rejected_psnr for r in rejected], "x", color=_RED, label=label)
    axis.set(ylabel="PSNR, dB (mean over views)")
    axis.legend()


def _count(axis: Any, records: Sequence[FrameRecord]) -> None:
    axis.step([r.frame for r in records], [r.gaussians for r in records], where="mid", color=_GREEN)
    axis.set(ylabel="Gaussians", ylim=(0, None))


def _static(axis: Any, records: Sequence[FrameRecord]) -> None:
    moving = [r for r in records if r.static]
    for name in moving[0].static if moving else []:
        axis.plot([r.frame for r in moving], [100 * r.static[name] for r in moving], label=name.replace("_", " "))
    axis.set(ylabel="% updates under half a step", ylim=(0, 101))
    if moving:
        axis.legend(ncols=3, fontsize="small")


def _seconds(axis: Any, records: Sequence[FrameRecord]) -> None:
    axis.bar([r.frame for r in records], [r.seconds for r in records], color=_BLUE)
    axis.set(ylabel="seconds")


def _heat(error: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(H, W, 3) black, red, yellow, white for errors (H, W) from 0 to 1; larger ones are white too."""
    e = np.clip(error, 0, 1)[..., None]
    return to_bytes(np.clip(3 * e - np.array([0.0, 1.0, 2.0]), 0, 1))


def frames_to_show(records: Sequence[FrameRecord]) -> list[int]:
    """First and last frame, the first six keyframes, and the frame of lowest PSNR in held-out (or training) views."""
    worst = min(records, key=lambda r: r.psnr if r.held_out_psnr is None else r.held_out_psnr)
    keys = [r.frame for r in records if r.kind == "key"][:6]
    return sorted({records[0].frame, *keys, worst.frame, records[-1].frame})


def _page(model: Model, shown: dict[int, str], jobs: str | None) -> str:
    records = model.record.frames
    held_out = [r.held_out_psnr for r in records if r.held_out_psnr is not None]
    matched = [r.held_out_matched for r in records if r.held_out_matched is not None]
    facts = {
        "frames": str(len(records)),
        "groups": str(len(model.record.keyframes())),
        "Gaussians": f"{records[0].gaussians:,} to {records[-1].gaussians:,}",
        "PSNR of training views": f"{np.mean([r.psnr for r in records]):.2f} dB",
        "PSNR of held-out views": f"{np.mean(held_out):.2f} dB, worst {min(held_out):.2f} dB" if held_out else "none",
        "with their exposure matched": f"{np.mean(matched):.2f} dB, worst {min(matched):.2f} dB" if matched else "none",
        "these PSNR are": f"the mean over frames of the {PSNR_DEFINITION}",
        "time": f"{sum(r.seconds for r in records):.0f} s",
    }
    rows = "".join(f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in facts.items())
    pictures = "".join(f'<h2>Frame {frame}</h2><img src="{name}" alt="frame {frame}">' for frame, name in shown.items())
    curves = '<img src="training.png" alt="PSNR, Gaussians, static updates and seconds a frame">'
    warnings = "".join(f"<p>Warning: {html.escape(warning)}</p>" for warning in model.record.warnings())
    link = f'<p><a href="{jobs}">Who did which job, and when</a></p>' if jobs else ""
    settings = f"<h2>Settings</h2><p><code>{html.escape(str(model.record.settings))}</code></p>"
    body = f"<table>{rows}</table>{link}{warnings}{pictures}<h2>Frame by frame</h2>{curves}{settings}"
    going_on = not model.record.complete
    if going_on:
        took, left = [r.seconds for r in records[1:]], model.record.total - len(records)
        time = f"; the others take {about(left * float(np.mean(took)))}" if took else ""
        body = f"<p>{len(records)} of {model.record.total} frames are trained{time}. This page fills.</p>{body}"
    style, again = "code{overflow-wrap:anywhere}", RELOADED_S if going_on else None
    return page(f"Training of {model.folder.name}", body, style=style, reload_s=again)
