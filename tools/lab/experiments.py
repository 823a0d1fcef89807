"""The one table of experiments: what each asks, its module with `Options` and `run`, and about how long it takes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Experiment:
    """A question that a program answers."""

    name: str
    question: str
    module: str
    takes: str  # on two cores, with its defaults or what the documents give it


def _bench(name: str, question: str, takes: str) -> Experiment:
    return Experiment(name, question, f"tools.lab.bench.{name.replace('-', '_')}", takes)


def _room(name: str, question: str, takes: str) -> Experiment:
    return Experiment(name, question, f"tools.lab.{name.replace('-', '_')}.experiment", takes)


EXPERIMENTS = (
    _bench("claims", "Do packages have the quality that they claim?", "10 min a scene"),
    _room("crowd", "What do thousands of viewers of one programme get, and what does it cost?", "30 min"),
    _bench("decode", "How long does decoding take beside the H.264 alone?", "1 min a package"),
    _bench("devices", "Do the CPU renderer and gsplat agree, and how fast are they?", "1 min, on a GPU"),
    _bench("engines", "What do spark and PlayCanvas lose of our pictures?", "2 min"),
    _bench("formats", "What does a round trip through each splat format cost?", "5 min"),
    _bench("jobs", "What does sharing work cost and gain?", "10 min"),
    _bench("keyframe", "How much sooner is a keyframe fitted from the frame before than from scratch?", "10 min"),
    _bench("link", "How far are simulated sessions from real ones?", "20 s a trace"),
    _bench("million", "How long does decoding a million Gaussians take?", "10 min"),
    _bench("play", "How fast are the selector, the bounds and the simulator?", "2 min"),
    _room("rd", "How many bytes does which quality take, here and in published formats?", "20 min a scene"),
    _bench("scale", "How do time, memory and bytes grow with Gaussians and frames?", "1 h"),
    _bench("serve", "How does the server hold out under many sessions?", "1 min"),
    Experiment("soak-farm", "Are the bytes the same where everything fails?", "tools.lab.soak.farm", "10 min"),
    Experiment("soak-live", "What does a day of publishing cost, and joining late?", "tools.lab.soak.live", "1 h"),
    _bench("splits", "How good is a training where nobody trained it?", "hours"),
    _bench("start", "How long does a user wait before anything happens?", "10 s"),
    _bench("static", "How many bytes do static splats take beside SPZ?", "2 min a file"),
    _room("tiles", "What do spatial tiles cost and save?", "30 min"),
    _bench("training-plan", "What does training take in memory and time?", "1 min"),
    _bench("viewpoints", "How close do found cameras come to the true ones?", "10 s a scene"),
    Experiment(
        "work-precision", "What buys quality, and what only time?", "tools.lab.numerics.work_precision", "20 minutes"
    ),
    Experiment("stiff", "Where do numbers at their ends lead?", "tools.lab.numerics.stiff", "2 minutes"),
    Experiment("dense", "What does pruning updates cost?", "tools.lab.paper.levels", "minutes"),
    Experiment("frames", "What does the paper's frame mode give over links?", "tools.lab.paper.streaming", "1 minute"),
    Experiment(
        "closed-loop", "What does a server save that knows its viewer?", "tools.lab.paper.closed_loop", "1 minute"
    ),
    Experiment("reproduce", "How do the methods of the paper compare?", "tools.lab.paper.reproduce", "an hour"),
    Experiment("footage", "What do cameras see of a Gaussian sequence?", "tools.lab.paper.footage", "minutes"),
)
