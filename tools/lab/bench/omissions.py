"""What leaving out saves: the top rung of each scene as it is, and with each thing that is left out taken back.

Steps, views and the pictures that measure are those of one calibration; a thing that is taken back changes nothing
else, so that PSNR differs too. Bytes are those of keys and states, without tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

from airgs_codec.encoder import pipeline, states
from airgs_codec.encoder.batch import Measuring, calibrate_sequence, encode_sequence, quality_query
from airgs_codec.encoder.measure import Rounds, measure_groups
from airgs_codec.encoder.omit import KeyOmissions, StateOmissions
from airgs_codec.encoder.pipeline import SURVEY
from airgs_codec.encoder.plan import WrittenRows, rank_updates
from airgs_codec.encoder.prepare import hold_frames, order_rows, prepare
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.jobs.work import temporary_work
from airgs_codec.media.h264 import DEFAULT_PRESET, PRESETS
from airgs_codec.package.manifest import pooled_quality
from airgs_codec.scene.sequence import GaussianSequence, open_sequence
from tools.lab import Lab, Page, Row, Section, Table, required, setting

BANDS = "SH bands"
AS_IT_IS = "as it is"
ROUNDS = Rounds(10).again(2)  # of pictures of a segment, the same ones for all
COLUMNS = {
    "scene": ("scene", ""), "taken_back": ("with", ""), "kilobytes": ("kB a frame", ".2f"), "psnr": ("PSNR, dB", ".2f"),
    "more": ("bytes, %", "+.1f"), "gained": ("dB", "+.2f"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("sequences; SCENE=CAMERAS names the cameras")
    x264_preset: str = setting(DEFAULT_PRESET, "x264 preset", choices=PRESETS)


def _free(of: type, name: str) -> AbstractContextManager[object]:
    choose = getattr(of, name)
    return patch.object(of, name, lambda self, price: choose(self, 0.0))


def _both(*patches: AbstractContextManager[object]) -> AbstractContextManager[object]:
    stack = ExitStack()
    for one in patches:
        stack.enter_context(one)
    return stack


TAKEN_BACK: dict[str, Callable[[], AbstractContextManager[object]]] = {
    AS_IT_IS: nullcontext,
    "rows that nobody sees": lambda: patch.object(
        pipeline, "keep_rows", lambda frames, *_: WrittenRows.all(len(frames[0]))
    ),
    "static rows": lambda: patch.object(states, "rank_updates", _rank_all),
    BANDS: nullcontext,
    "planes": lambda: _both(_free(KeyOmissions, "planes"), _free(StateOmissions, "planes")),
    "segments": lambda: _free(StateOmissions, "segments"),
}


def _rank_all(states: Any, changes: Any, weights: Any, usage: Any, rank: str, _: bool) -> Any:
    """`rank_updates` that holds no row still but what hardly changes."""
    return rank_updates(states, changes, weights, usage, rank, keep_all=True)


def run(options: Options, lab: Lab) -> Page:
    rows = [row for scene in options.scenes for row in measure(scene, options.x264_preset, lab)]
    return Page([Section(answer(rows), tables=[Table("omissions", rows, COLUMNS)])])


def measure(scene: str, preset: str, lab: Lab) -> Iterator[Row]:
    name, _, cameras = scene.partition("=")
    sequence = hold_frames(open_sequence(name, views=cameras or None))
    with_all: tuple[float, float] | None = None
    for what, taken_back in TAKEN_BACK.items():
        with taken_back():
            got = _top_rung(sequence, EncodeSettings(preset=preset), what == BANDS, lab)
        with_all = with_all or got
        if what == AS_IT_IS or got != with_all:
            row: Row = {"scene": name.rstrip("/").rpartition("/")[2], "taken_back": what}
            row |= {"kilobytes": got[0] / 1e3, "psnr": got[1]}
            yield row | {"more": 100 * (got[0] / with_all[0] - 1), "gained": got[1] - with_all[1]}


def _top_rung(sequence: GaussianSequence, settings: EncodeSettings, bands: bool, lab: Lab) -> tuple[float, float]:
    """Bytes a frame and PSNR; `bands`: with all SH bands. Calibration, which nothing changes, is cached."""
    with temporary_work(lab.progress) as work:
        original = prepare(order_rows(sequence, settings, work), settings, work, None)
        work.run([original.job(SURVEY, group) for group in original.windows[0]])
        found = calibrate_sequence(original, settings, work)
        top = replace(found.settings, levels=found.settings.levels[:1], key_factors=found.settings.key_factors[:1])
        measuring = Measuring(original, ROUNDS)
        encoded = encode_sequence(original if bands else found.prepared, top, work, measuring)
        m = measure_groups(quality_query(encoded, measuring)).whole(encoded.manifest)
    quality = pooled_quality(m, 0, 0)
    assert quality is not None
    return m.bytes_of(m.rung_files(0, 0)) / m.frames, quality.psnr


def answer(rows: Sequence[Row]) -> str:
    taken = [row for row in rows if row["taken_back"] != AS_IT_IS]
    if not taken:
        return "Nothing is left out."
    most, dearest = (max(taken, key=lambda row: row[key]) for key in ("more", "gained"))
    saved = f"Leaving out {most['taken_back']} saves most: with them {most['scene']} takes {most['more']:.1f} % more"
    cost = f"What is left out costs {max(0.0, dearest['gained']):.2f} dB at most"
    return f"{saved}. {cost} ({dearest['taken_back']} of {dearest['scene']})."
