"""Our packages and the re-implemented layouts as trials of the benchmark."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.encoder.target import PSNR, Goal
from airgs_codec.package.package import open_package
from airgs_codec.scene.gaussians import Gaussians
from tools.lab import seconds_of
from tools.lab.rd.layouts import PUBLISHED, V3_FORMS, CodedGroup, mpeg_anchor_layout, v3_layout
from tools.lab.rd.subject import Coded, Subject, Trial

OURS, OURS_WHOLE = "airgs", "airgs, keeps all"
V3, MPEG = "V3 layout", "MPEG anchor layout"
PRESETS = (PUBLISHED, "veryslow")  # of the layouts; the second is the one that airgs uses by default
V3_QPS = (6, 10, 14, 18, 22, 26, 30, 34, 40, 46)
# The MPEG anchor's published rate points, finest first, from its lowest QPs up.
MPEG_QPS = (
    {"opacity": 1, "quaternions": 1, "log_scales": 1, "sh_dc": 1, "sh_rest": 4},
    {"opacity": 4, "quaternions": 4, "log_scales": 4, "sh_dc": 4, "sh_rest": 4},
    {"opacity": 4, "quaternions": 10, "log_scales": 10, "sh_dc": 4, "sh_rest": 16},
    {"opacity": 10, "quaternions": 16, "log_scales": 16, "sh_dc": 10, "sh_rest": 22},
    {"opacity": 16, "quaternions": 22, "log_scales": 22, "sh_dc": 16, "sh_rest": 28},
    {"opacity": 22, "quaternions": 28, "log_scales": 28, "sh_dc": 22, "sh_rest": 34},
)
Layout = Callable[[Sequence[Gaussians]], CodedGroup]


def our_trials(targets: Sequence[float], keep_all: bool) -> Iterator[Trial]:
    """The top rung of packages that reach each PSNR of `targets`, in dB."""
    for target in targets:
        name = OURS_WHOLE if keep_all else OURS
        yield Trial(name, f"{target:g} dB", partial(_our_package, target, keep_all))


def _our_package(target_db: float, keep_all: bool, subject: Subject) -> Coded:
    """All tiers, sidecars, tables and both manifests count.

    Seconds of encoding include what the plan takes but for the search for the target.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "package"
        settings = EncodeSettings(keep_all=keep_all, measure_pictures=0)
        report = encode(subject.sequence, path, settings, goal=Goal(PSNR, target_db))
        package = open_package(path)
        m = package.manifest
        took, frames = seconds_of(lambda: {f.number: f.gaussians for f in decode_frames(package, 0, m.frames)})
    size = m.bytes_of(m.rung_files(0, 0)) + package.manifest_bytes
    encode_s = report.encode_s + sum(one.seconds for one in report.plan.choices if one.about != "quality")
    return Coded(size / m.frames, frames, encode_s, took.wall)


def v3_name(form: str, preset: str) -> str:
    """The coder that V^3's layout in a form is at a preset."""
    return f"{V3}, {form}, {preset}"


def layout_trials() -> Iterator[Trial]:
    """V^3's layout in both forms and MPEG's, at both presets."""
    for preset in PRESETS:
        for form in V3_FORMS:
            for qp in V3_QPS:
                layout: Layout = partial(v3_layout, qp=qp, preset=preset, form=form)
                yield Trial(v3_name(form, preset), f"qp {qp}", partial(_group_by_group, layout))
        for rate, qps in enumerate(MPEG_QPS):
            layout = partial(mpeg_anchor_layout, qps=qps, preset=preset)
            yield Trial(f"{MPEG}, {preset}", f"rate {rate}", partial(_group_by_group, layout))


def _group_by_group(layout: Layout, subject: Subject) -> Coded:
    took, groups = seconds_of(lambda: {start: layout(frames) for start, frames in subject.groups})
    decode_s = sum(group.decode_s for group in groups.values())
    shown = {start + i: frame for start, group in groups.items() for i, frame in enumerate(group.frames)}
    return Coded(
        sum(group.bytes for group in groups.values()) / len(subject.sequence), shown, took.wall - decode_s, decode_s
    )
