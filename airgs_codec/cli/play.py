"""airgs-play: a package over a bandwidth trace or over HTTP, one session or a study of many."""

from __future__ import annotations

from dataclasses import field, replace
from functools import partial
from itertools import chain
from pathlib import Path

from airgs_codec._report import listed
from airgs_codec._settings import required, setting
from airgs_codec.cli.options import (
    CUDA,
    DEVICE,
    PACKAGE,
    BakingOptions,
    Given,
    as_options,
    expect_folder,
    expect_report,
    given,
    open_frames,
    run_program,
)
from airgs_codec.cli.terminal import Bar, say, warn
from airgs_codec.errors import ConfigError
from airgs_codec.package.package import find_faults, open_package
from airgs_codec.package.region import region_figures
from airgs_codec.places.whole import to_json
from airgs_codec.play.film import film
from airgs_codec.play.http import HttpDownloader, HttpSettings
from airgs_codec.play.playout import SessionSettings
from airgs_codec.play.policies import DEFAULT_POLICY, POLICY_NAMES
from airgs_codec.play.report import format_metrics, write_report
from airgs_codec.play.session import SessionLog, simulate
from airgs_codec.play.session import play as play_over
from airgs_codec.play.study import StudySettings, format_study, run_study, study_record
from airgs_codec.play.trace import DEFAULT_RTT_S, TRACE_ENDS, Link, Trace
from airgs_codec.render.backend import open_renderer

COMPARED = (DEFAULT_POLICY, *(name for name in POLICY_NAMES if name not in (DEFAULT_POLICY, "oracle-lp")))
TRACES = "a file (rows of times and rates, sabre JSON, mahimahi), const:MBPS or markov:SEED[:MBPS]"


@as_options
class Play:
    package: str = required(f"{PACKAGE}, or where a web server has it")
    trace: str | None = setting(None, f"rates of the link: {TRACES}")
    policy: str = setting(DEFAULT_POLICY, f"what chooses rungs; {', '.join(POLICY_NAMES)}, fixed:LEVEL or fixed:RUNG")
    rtt: float | None = setting(None, "round trip", metavar="MS", default=f"the trace's, else {1e3 * DEFAULT_RTT_S:g}")
    offset: float = setting(0.0, "where in the trace to begin", metavar="S", topic="link")
    scale: float = setting(1.0, "factor on the trace's rates", topic="link")
    end: str = setting("loop", "what follows the trace's last second", choices=TRACE_ENDS, topic="link")
    player: Given = given(SessionSettings, "player", ("buffer_s", "budget", "loops"), "player")
    http: Given = given(HttpSettings, "http, for a URL", name="http")
    compare: bool = setting(False, "compare policies with each other on --traces")
    traces: tuple[str, ...] = setting((), "folders of traces, or traces", metavar="PLACE...")
    policies: str = setting(",".join(COMPARED), "policies to compare, with commas", default="eight of them")
    offsets: int = setting(8, "starts in each trace, drawn from --seed")
    seed: int = setting(1, "seed of the starts", topic="study")
    jobs: int = setting(1, "processes that share the sessions of --compare")
    original: str | None = setting(None, "shown beside the screen in --video", metavar="SEQUENCE")
    device: str = setting("auto", f"where pictures are drawn{CUDA}", topic="output", **DEVICE)
    report: Path | None = setting(None, "folder for a page", metavar="DIR")
    video: Path | None = setting(None, "film what was on the screen, as MP4", metavar="FILE")
    json: bool = setting(False, "print figures as JSON")
    baking: BakingOptions = field(default_factory=BakingOptions)

    @property
    def rtt_s(self) -> float | None:
        return None if self.rtt is None else self.rtt / 1e3


def play(options: Play) -> int:
    """Simulate a viewer of a package over a bandwidth trace, compare policies over many, or play from a web server."""
    expect_report(options.report)
    if options.video:
        if options.video.suffix.lower() != ".mp4":
            raise ConfigError(f"{options.video}: expected a name that ends in .mp4")
        expect_folder(options.video.absolute().parent)
    rules = SessionSettings(**options.player)
    if options.package.startswith(("http://", "https://")):
        return _over_http(options, rules)
    if options.http.get("as_fast"):
        raise ConfigError(f"--http.as-fast: expected a URL, got {options.package}; a simulated session takes no time")
    package = open_package(options.package)
    if options.compare:
        return _compare(options, rules)
    if not options.trace:
        raise ConfigError(
            "expected --trace, of whose link a viewer is simulated, such as const:8, or --compare with --traces; "
            f"to watch the package: airgs-serve {options.package} --open"
        )
    trace = replace(Trace.open(options.trace).cut(options.offset, options.scale), end=options.end)
    log = simulate(package, Link.over(trace, options.rtt_s), options.policy, rules, find_faults(package))
    _present(log, options)
    return 0


def _over_http(options: Play, rules: SessionSettings) -> int:
    if options.trace or options.compare:
        raise ConfigError("a URL is played over the real connection: expected no --trace and no --compare")
    settings = HttpSettings(**options.http)
    with HttpDownloader(options.package, settings, None, lambda line: warn(f"airgs-play: {line}")) as downloader:
        log = play_over(downloader.open(), downloader, options.policy, rules)
    _present(log, options)
    return 0


def _present(log: SessionLog, options: Play) -> None:
    original, baking = options.original, vars(options.baking)
    sequence = open_frames(original, quiet=options.json, **baking) if original else None
    if options.report:
        write_report(log, options.report)
    if options.video:
        if all(shown.rung is None for shown in log.shown):
            raise ConfigError(f"{options.package}: nothing can be shown: {listed(log.lost)}")
        options.video.parent.mkdir(parents=True, exist_ok=True)
        with Bar(options.json) as bar:
            film(open_package(options.package), log, options.video, sequence, bar, open_renderer(options.device))
    if options.json:
        more = {"policy": log.policy, "lost": log.lost, "retried": log.retried}
        say(to_json(log.metrics.as_dict() | more | {"region": region_figures(log.offers.manifest.region)}))
        return
    say(format_metrics(log))
    for name, path in (("report", options.report and options.report / "index.html"), ("film", options.video)):
        if path:
            say(f"{name:<22}{path}")


def _compare(options: Play, rules: SessionSettings) -> int:
    single = {"player.budget": rules.budget, "report": options.report, "video": options.video}
    if given := [name for name, value in single.items() if value is not None]:
        raise ConfigError(f"--{given[0]}: expected a single session, got --compare")
    places = {place: Path(place) for place in options.traces}
    found = [sorted(map(str, filter(Path.is_file, at.iterdir()))) if at.is_dir() else [p] for p, at in places.items()]
    if not found or not all(found):
        raise ConfigError("--compare: expected --traces with traces, or folders that are not empty")
    how = {name: getattr(options, name) for name in ("offsets", "scale", "end", "rtt_s", "seed", "jobs")}
    policies = tuple(filter(None, options.policies.split(",")))
    settings = StudySettings(policies, tuple(chain(*found)), session=rules, **how)
    with Bar(options.json) as bar:
        study = run_study(options.package, settings, bar)
    say(to_json(study_record(study)) if options.json else format_study(study))
    return 0


main = partial(run_program, "airgs-play", play)
