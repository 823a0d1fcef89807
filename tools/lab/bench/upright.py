"""How often stills are shown upright and from in front, and how often a wrong guess is told as a fact.

Stills are frames of files, clips and sequences, clouds of points, and models as Gaussians (tools.make_crowd). Each is
turned as files of a form mostly are, the other way up, with z up, and at random, and written in some form with -y up
and some with y up. Up is right within 30 degrees, a front within 60. `held`: no constant was chosen on these scenes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from airgs_codec._report import BLUE, GREEN, GREY, RED
from airgs_codec._sampling import evenly_spaced
from airgs_codec.analysis.viewpoints import find_viewpoints
from airgs_codec.package.region import parse_up
from airgs_codec.scene.camera import UP
from airgs_codec.scene.formats.ply import read_points
from airgs_codec.scene.formats.table import FRAMES, write
from airgs_codec.scene.frames import repair
from airgs_codec.scene.gaussians import Gaussians, multiply
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.trainer.fit.points import from_points
from tools.lab import Lab, Page, PagePicture, Row, Section, Table, content, required, setting
from tools.lab.made import name_of
from tools.make_crowd import Model, crowd

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOMENTS, ROWS = 2, 10_000  # of a sequence, and Gaussians of a model
LIKE = [form for form in FRAMES if not form.axes], [form for form in FRAMES if form.axes]  # -y and y is up
RIGHT, AHEAD = np.cos(np.radians([30, 60]))
TURNS = ("as the form", "the other way up", "z up", "at random")
HALVES = ("looked at", "held back")
KINDS = ("right", "doubted, right", "doubted, wrong", "wrong")


@dataclass(frozen=True, slots=True)
class Options:
    scenes: tuple[str, ...] = required("scenes, with what is truly up, and their front if any: SCENE@UP[@FRONT]")
    held: tuple[str, ...] = setting((), "names of the scenes that nothing was chosen on")


def run(options: Options, lab: Lab) -> Page:
    rows = list[Row]()
    for scene in options.scenes:
        place = scene.partition("@")[0]
        found = lab.results.once("upright", [scene, content(Path(place))], partial(measure, scene))
        half = HALVES[name_of(place) in options.held]
        rows += [{"scene": name_of(place), "half": half} | row for row in found]
    tables, more = [counts(rows, key, "up") for key in ("turn", "scene")], counts(rows, "form", "up")
    fronts = [row for row in rows if "front" in row]
    picture = PagePicture(
        "upright", "Guesses of which way is up, by how files are turned", partial(draw, tables[0].rows), (6.5, 3.2)
    )
    data = [*tables[1:], more, counts(fronts, "scene", "front")]
    return Page([Section("", "", [picture], tables[:1])], data=data)


def draw(rows: Sequence[Mapping[str, Any]], figure: Figure) -> None:
    axis, left = figure.subplots(), np.zeros(len(rows))
    for kind, colour in zip(KINDS, (GREEN, BLUE, GREY, RED), strict=True):
        widths = np.array([row[kind] for row in rows])
        axis.barh([f"{row['turn']} ({row['half']})" for row in rows], widths, left=left, color=colour, label=kind)
        left += widths
    axis.invert_yaxis()
    axis.set(xlabel="files", ylabel="turn of the files (scenes)")
    figure.legend(loc="outside upper center", ncols=len(KINDS))


def measure(scene: str) -> list[Row]:
    place, *truth = scene.split("@")
    random, known = np.random.default_rng(list(scene.encode())), [np.array(parse_up(one)) for one in truth]
    return [row for still in stills(place) for row in tried(still, known, random)]


def stills(place: str) -> Iterator[Gaussians]:
    path = Path(place)
    if path.name.startswith("points"):
        cloud = read_points(path) if path.suffix == ".ply" else np.split(np.load(path)["data"][:, :6], 2, axis=1)
        at, colours = (np.asarray(one, np.float32) for one in cloud)
        yield from_points(at, colours, 0, 0.9, np.ptp(at, axis=0).max() / 50)
    elif path.parent.name == "models":
        yield next(crowd([Model(path)], ROWS, 1))
    else:
        frames = open_sequence(path)
        yield from (frames.read(i) for i in evenly_spaced(len(frames), min(MOMENTS, len(frames))))


def tried(still: Gaussians, truth: Sequence[NDArray[np.float64]], random: np.random.Generator) -> Iterator[Row]:
    """What is guessed of a still in every turn and form; `truth`: what is up, and what is ahead if it has a front."""
    still = repair([still], "still").frames[0].with_degree(0)
    by_chance = Rotation.random(random_state=random)
    for forms in LIKE:
        for number, name in enumerate(TURNS):
            form = forms[random.integers(len(forms))]
            usual = np.array(form.axes.up if form.axes else UP)
            to = (usual, -usual, np.array([0.0, 0, 1]), None)[number]
            turn = by_chance if to is None else Rotation.align_vectors([to], [truth[0]])[0]
            turns = multiply(turn.as_quat(scalar_first=True)[None], still.quaternions.astype(np.float64))
            turned = replace(still, means=turn.apply(still.means).astype("f4"), quaternions=turns.astype("f4"))
            with TemporaryDirectory() as folder:
                write(turned, path := Path(folder) / f"still.{form.key}")
                found = find_viewpoints([open_sequence(path).read(0)], None, form.axes, path.suffix)
            right, doubted = found.up @ turn.apply(truth[0]) > RIGHT, found.guess.startswith("cannot")
            row = {"form": form.name, "turn": name, "up": KINDS[doubted if right else 3 - doubted]}
            if right and len(truth) > 1 and "a filmed place" not in found.summary:
                ahead = found.cameras[0].world_to_camera[2, :3] @ turn.apply(truth[1]) < -AHEAD
                row["front"] = KINDS["may be" in found.summary if ahead else 3 - ("may be" in found.summary)]
            yield row


def counts(rows: Sequence[Row], key: str, of: str) -> Table:
    """How many rows are of each kind, for each half and value of `key`."""
    found = Counter((row["half"], row[key], row[of]) for row in rows)
    groups = sorted({group[:2] for group in found}, key=lambda group: (HALVES.index(group[0]), group[1]))
    table = [{"half": half, key: value} | {kind: found[half, value, kind] for kind in KINDS} for half, value in groups]
    return Table(f"{of} by {key}", table)
