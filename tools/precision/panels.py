"""The table of the report: its sections, and the panels of each with their question and conclusion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tools.precision import conclusions, decode, encode, renderer, selector, survey, trainer
from tools.precision.bench import Bench
from tools.precision.rows import Row

MS, MICRO = 1e3, 1e6


@dataclass(frozen=True, slots=True)
class Panel:
    """A question that some rows answer."""

    name: str
    question: str
    conclusion: Callable[[list[Row]], str]
    x: str  # label of the axis of time
    y: str  # label of the axis of error
    scale: float = 1.0  # of seconds
    log_error: bool = False
    labels: bool = True  # settings stand beside their points
    loose: tuple[str, ...] = ()  # curves whose points are not joined
    bars: bool = False  # a bar for each curve, without errors


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the report, with a picture of its own."""

    name: str
    title: str
    measure: Callable[[Bench], Iterator[Row]]
    about: str  # how it was measured, in whole sentences
    panels: tuple[Panel, ...]

    def rows_of(self, panel: Panel, rows: list[Row]) -> list[Row]:
        """The rows of a panel."""
        return [row for row in rows if (row.section, row.panel) == (self.name, panel.name)]


SECTIONS = (
    Section(
        "encode",
        "Encoding",
        encode.measure,
        "Packages of one rung. The bytes are everything that a viewer fetches but the manifests, at 43 dB between two "
        "encodes near it; the seconds are those of the whole encode near it but for measuring, and calibrations are "
        "not taken from the cache.",
        (
            Panel(
                "presets",
                "What do slower presets and calibration buy at 43 dB?",
                conclusions.presets,
                "CPU seconds of an encode",
                encode.UNIT,
            ),
        ),
    ),
    Section(
        "survey",
        "Looking",
        survey.measure,
        "A claim is the PSNR of a package of one rung in some pictures, drawn anew for every trial; the truth is that "
        "of other views in all frames. The encoder's own claims also need SSIM and CIEDE2000, draw more pictures until "
        "they are sure, and are one trial each.",
        (
            Panel(
                "claims",
                "How many pictures make a claimed PSNR true?",
                conclusions.claims,
                "CPU seconds of looking",
                survey.OFF,
                log_error=True,
                labels=False,
                loose=(survey.OWN,),
            ),
            Panel(
                "deciding",
                "What do more pictures that decide buy at 43 dB?",
                conclusions.deciding,
                "CPU seconds of the survey",
                encode.UNIT,
            ),
        ),
    ),
    Section(
        "decode",
        "Decoding",
        decode.measure,
        "The package of the default settings, decoded in order by one process. PSNR is that of the same 24 pictures "
        "for every point, from views that the encoder has not drawn.",
        (
            Panel(
                "rungs",
                "What does a cheaper rung save in decoding?",
                conclusions.rungs,
                "CPU milliseconds a frame",
                decode.UNIT,
                MS,
            ),
            Panel(
                "stages",
                "Where does the time of the top rung go?",
                conclusions.stages,
                "CPU milliseconds a frame",
                "",
                MS,
                bars=True,
            ),
        ),
    ),
    Section(
        "renderer",
        "Rendering",
        renderer.measure,
        "Errors are those of crops at full size against the definition in float64 with its cut-off of 1/255; the "
        "definition's seconds are those of the crops times the ratio of pixels. Tile size and cut-off are constants: "
        "for the other points the kernels were compiled again with other numbers.",
        (
            Panel(
                "precision",
                "What does float32 cost, and what do tiles save?",
                conclusions.precision,
                "CPU seconds a picture",
                renderer.UNIT,
                log_error=True,
                labels=False,
            ),
            Panel(
                "tiles",
                "Would tiles of another size be faster?",
                conclusions.tiles,
                "CPU milliseconds a picture",
                renderer.UNIT,
                MS,
                log_error=True,
            ),
            Panel(
                "cuts",
                "Would a coarser cut-off of alpha be worth its error?",
                conclusions.cuts,
                "CPU milliseconds a picture",
                renderer.UNIT,
                MS,
                log_error=True,
            ),
        ),
    ),
    Section(
        "trainer",
        "Training",
        trainer.measure,
        "The six frames of `tests/data/fox_views` at 128 x 128 pixels, a budget of 4,000 Gaussians. Its four cameras "
        "that are held out judge, and chose nothing here. Runs differ by their seed. Networks of frames in a group "
        "have learnt nothing before, while in a run they learn on from frame to frame.",
        (
            Panel("first", "When has a first frame settled?", conclusions.first, "CPU seconds", trainer.UNIT),
            Panel(
                "views", "Are more views an iteration worth their time?", conclusions.views, "CPU seconds", trainer.UNIT
            ),
            Panel(
                "keyframe",
                "Is a keyframe better fitted from the frame before?",
                conclusions.keyframe,
                "CPU seconds",
                trainer.UNIT,
            ),
            Panel("frame", "How should frames in a group move?", conclusions.frame, "CPU seconds", trainer.UNIT),
        ),
    ),
    Section(
        "selector",
        "Choosing",
        selector.measure,
        "Sessions of the fox over seeded links of one and a half times the rate of its top rung; points are medians "
        "over choices (time) and over links (regret), bars their quartiles. Dense levels lie between those of the "
        "package; their regret is the distance to a ladder without gaps. Where bars overlap, links decide "
        "more than policies.",
        (
            Panel(
                "policies",
                "Which policy is worth its time?",
                conclusions.policies,
                "CPU microseconds a choice",
                selector.UNIT,
                MICRO,
            ),
            Panel(
                "horizon",
                "How far ahead should a player plan?",
                conclusions.horizon,
                "CPU microseconds a choice",
                selector.UNIT,
                MICRO,
            ),
            Panel(
                "levels",
                "How many levels are enough, and who should choose?",
                conclusions.levels,
                "CPU microseconds a frame",
                selector.UNIT,
                MICRO,
                log_error=True,
            ),
        ),
    ),
)
NAMES = tuple(section.name for section in SECTIONS)
