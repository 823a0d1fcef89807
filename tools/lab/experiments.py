"""The tables of experiments and of what they make.

An experiment has a question, a module with `Options` and `run`, and a time that it takes. A measurement is what a
document of results shows of one. A figure of a document that no measurement makes has the command that makes it: a test
holds that nothing is left out, and all is there.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Experiment:
    name: str
    question: str
    module: str
    takes: str  # on two cores, with its defaults or what the documents give it


def _bench(name: str, question: str, takes: str) -> Experiment:
    return Experiment(name, question, f"tools.lab.bench.{name.replace('-', '_')}", takes)


EXPERIMENTS = (
    _bench("claims", "Do packages have the quality that they claim?", "10 min a scene"),
    _bench("engines", "What do spark and PlayCanvas lose of our pictures?", "2 min"),
    _bench("jobs", "What does sharing work cost and gain?", "10 min"),
    _bench("link", "How far are simulated sessions from real ones?", "20 s a trace"),
    _bench("mechanisms", "What does each mechanism buy?", "20 min a scene"),
    Experiment(
        "rd",
        "How many bytes does which quality take, here and in published formats?",
        "tools.lab.rd.experiment",
        "20 min a scene",
    ),
    Experiment("rivals", "What are the methods compared with?", "tools.lab.baselines.rivals", "10 minutes"),
    _bench("pace", "How long do encodes and trainings take, here and in other trees?", "5 min a scene and tree"),
    _bench("scale", "How do time, memory and bytes grow with Gaussians and frames?", "1 h"),
    _bench("scenes", "What is measured?", "10 s"),
    _bench("soak-farm", "Are the bytes the same where everything fails?", "10 min"),
    _bench("splits", "How good is a training where nobody trained it?", "hours"),
    _bench("streaming", "What do viewers get over LTE?", "5 minutes"),
    _bench("static", "How many bytes do static splats take beside SPZ?", "2 min a file"),
    _bench("tracked", "What does tracking make of frames that know nothing of each other?", "5 min"),
    _bench("upright", "How often are up and front of stills right?", "30 s a scene"),
    _bench("viewpoints", "How close do found cameras come to the true ones?", "10 s a scene"),
    Experiment(
        "work-precision", "What buys quality, and what only time?", "tools.lab.numerics.work_precision", "20 minutes"
    ),
    Experiment("stiff", "Where do numbers at their ends lead?", "tools.lab.numerics.stiff", "2 minutes"),
    Experiment(
        "extremes", "What becomes of sequences at the ends of numbers?", "tools.lab.numerics.extremes", "1 minute"
    ),
    Experiment("reproduce", "How do the methods of the paper compare?", "tools.lab.paper.reproduce", "an hour"),
)


@dataclass(frozen=True, slots=True)
class Measurement:
    name: str  # of its marks in the document, and of its entry in figures.json
    document: str  # in docs/results, without .md
    words: str  # of the command after `python -m tools.lab`, which runs in a folder of scenes


# In the folder of scenes, talk/ is that of the showcase; frames of fox_alone/ are those of naive 3DGS, 8 of fox_views/
# with cam01, 05, 09 and 13 held out, as in its transforms.json. fox_b/ and fox_plain/ are fox/ without
# cameras, and fox_b.json holds out cam02, 06, 11 and 14.
# fox_128/ is tests/data/fox_views, head_views/ what `tools.make_footage` makes of head/ from cameras around it.
PEERS = "--splat4d peers/bin/splat4d --fourdgs peers/bin/python --splat-transform 'peers/splat-transform -g cpu'"
MEASUREMENTS = (
    Measurement(
        "scenes", "size",
        "scenes talk/ fox/=fox/transforms.json kinoptic/=kinoptic/transforms.json coffee10.splatv "
        "basketball/=basketball/transforms.json head/ spinach_4.splatv=spinach_views.json",
    ),
    Measurement(
        "rd-fox", "size",
        f"rd fox/ fox/transforms.json --fps 24 --frames 24 --targets 48 46 44.5 43 41.5 40 38 {PEERS}",
    ),
    Measurement(
        "claims", "size",
        "claims fox/=fox/transforms.json head/ spinach_4.splatv=spinach_views.json "
        "basketball/=basketball/transforms.json coffee10.splatv kinoptic/=kinoptic/transforms.json "
        "--targets default 36 40 43 --pictures 128",
    ),
    Measurement(
        "rd-spinach", "size", f"rd spinach10/ spinach_views.json --fps 30 --at 40 --targets 42 40 38 36 {PEERS}"
    ),
    Measurement(
        "rd-talk", "size", f"rd talk/ talk/transforms.json --at 43 --targets 47 45 43 41 39 37 {PEERS}"
    ),
    Measurement(
        "rivals", "size",
        "rivals fox/=fox/transforms.json head10/=head_views.json spinach10/=spinach_views.json",
    ),
    Measurement("static", "size", "static donut_fused.ply kacytran_iter7000.ply playbot/3_0"),
    Measurement("tracked-head", "size", "tracked head/ head_views.json --fps 30"),
    Measurement("tracked-fox", "size", "tracked fox_alone/ fox_alone/transforms.json --fps 24 --frames 8 --as-it-is"),
    Measurement(
        "paper", "paper",
        "reproduce --scenes fox=fox_128/ head=head_views/ --traces raca2018_4g_car/ --jobs 2",
    ),
    Measurement("splits-fox", "training", "splits fox_views/ --splits 2"),
    Measurement("splits-basketball", "training", "splits basketball_views/ --splits 6 --only 4 5 --frames 0:10"),
    Measurement(
        "splits-kinoptic", "training",
        "splits kinoptic_views/ --splits 4 --hold 2 --only 1 2 --frames 0:10 '--train=--max-size 480'",
    ),
    Measurement(
        "work-precision", "time",
        "work-precision --spinach spinach_4.splatv --traces raca2018_4g_car/ norway2013_3g/ ghent2016_4g/",
    ),
    Measurement("stiff", "numerics", "stiff"),
    Measurement("extremes", "numerics", "extremes"),
    Measurement(
        "streaming", "streaming",
        "streaming fox/ talk/ --links 'car LTE=raca2018_4g_car' 'Norwegian 3G=norway2013_3g' "
        "'Ghent 4G, a tenth=ghent2016_4g@0.1'",
    ),
    Measurement(
        "link", "streaming",
        "link talk/ raca2018_4g_car/A_2017.12.04_15.24.12.csv raca2018_4g_car/A_2017.12.06_13.01.21.csv "
        "raca2018_4g_car/A_2017.12.07_08.08.44.csv",
    ),
    Measurement(
        "viewpoints",
        "views",
        "viewpoints spinach_4.splatv=spinach_views.json fox/=fox/transforms.json "
        "basketball/=basketball/transforms.json kinoptic/=kinoptic/transforms.json coffee10.splatv "
        "kacytran_iter7000.ply",
    ),
    Measurement(
        "upright", "views",
        "upright fox/@y@z head/@y@z donut.ply@z playbot_3@-y@-z playbot_5@-y@-z "
        "coffee10.splatv@-y points_snowmiku.ply@-y points_kinoptic.npz@-y@-x models/Fox.glb@y@z spinach_4.splatv@-y "
        "guitar.compressed.ply@-y@x points_basketball.ply@-y models/Knight.glb@y@1,0,1 models/RiggedFigure.glb@y@x "
        "--held guitar.compressed spinach_4 points_basketball Knight RiggedFigure",
    ),
    Measurement("engines", "views", "engines --scenes fox/ ball-0 ball-3"),
    Measurement(
        "mechanisms", "mechanisms",
        "mechanisms fox/=fox/transforms.json fox_b/=fox_b.json head/@head_held.json spinach25/=spinach_views.json",
    ),
    Measurement("mechanisms-basketball", "mechanisms", "mechanisms basketball/"),
    Measurement("mechanisms-trainer", "mechanisms", "mechanisms fox_views/:8:13 kinoptic_views/:8:13"),
    Measurement(
        "mechanisms-sparse", "mechanisms",
        "mechanisms kinoptic_views/:0:5 --only 'walls around a sparse rig' 'dropout in a sparse rig'",
    ),
    Measurement(
        "mechanisms-exposure", "mechanisms",
        "mechanisms basketball_views/:0:3 --only 'exposure of cameras' 'nothing but other random numbers'",
    ),
    Measurement("pace", "time", "pace fox/ fox_plain/ head/ --trees 3a92d83c now"),
    Measurement("scale", "time", "scale"),
    Measurement("jobs", "time", "jobs"),
    Measurement("soak-farm", "time", "soak-farm --groups 60 --kills 12"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Figure:
    file: str  # below docs/; of tables the document itself
    document: str
    command: str


def _of(document: str, command: str, *files: str) -> tuple[Figure, ...]:
    return tuple(Figure(file, document, command) for file in files or (document,))


FIGURES = (
    *_of("docs/browser.md", "python -m tools.screenshot manifests/showcase/head.airgs -o docs/browser.png",
         "docs/browser.png"),
    *_of("docs/datapath.svg", "(drawn by hand)"),
    *_of("docs/encoding.md", "airgs-manifest inspect fox.airgs --plot docs/ladder.png", "docs/ladder.png"),
    *_of("docs/playing.md", "python -m tools.make_film", "docs/session.webp"),
    *_of("docs/tracking.md", "airgs-encode noisy/ -o OUT --report OUT",
         "docs/tracking.png"),
    *_of("docs/training.md", "airgs-train fox/ -o OUT --report OUT", "docs/results/training.png"),
)  # fmt: skip
