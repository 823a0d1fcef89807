"""airgs-play: a package over a bandwidth trace or over HTTP, one session or a study of many."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from airgs_codec._report import require_matplotlib
from airgs_codec._settings import about
from airgs_codec.cli.baking import add_baking, told_baking
from airgs_codec.cli.common import PACKAGE, Bar, add_device, add_views, run_command
from airgs_codec.decoder.decode import measure_decoding
from airgs_codec.errors import ConfigError
from airgs_codec.media.image import write_png
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package, find_faults, open_package
from airgs_codec.package.region import before_background
from airgs_codec.places.place import Folder
from airgs_codec.places.whole import to_json
from airgs_codec.play.http import HttpDownloader, fetch_beside
from airgs_codec.play.http_files import HttpSettings
from airgs_codec.play.offers import Offers
from airgs_codec.play.policies.named import DEFAULT_POLICY, NAMES, make_policy
from airgs_codec.play.report.film import film, still
from airgs_codec.play.report.map import Viewer, path_of
from airgs_codec.play.report.session import format_metrics, place_record, write_report
from airgs_codec.play.report.study import format_study, write_study
from airgs_codec.play.session import SessionLog, play, simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.sight import View
from airgs_codec.play.study import StudySettings, run_study
from airgs_codec.play.trace import DEFAULT_RTT_S, ENDS, Link, open_trace
from airgs_codec.render import read_cameras
from airgs_codec.render.backend import open_renderer
from airgs_codec.scene.sequence import open_sequence

PAPER = ("paper", "paper-no-cliff", "paper-literal", "paper-literal-no-cliff")
COMPARED = ("robust-mpc", *PAPER, "throughput", "bola", "oracle-frame")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="airgs-play",
        description="Simulate a viewer of a package over a bandwidth trace, compare policies over many, or play it "
        "from a web server.",
    )
    parser.add_argument("package", metavar="PACKAGE|URL", help=f"{PACKAGE}, or where a web server has it")
    traces = "a file (Raca CSV, sabre JSON, seconds and Mbit/s, mahimahi), const:MBPS or markov:SEED[:MBPS]"
    parser.add_argument("--trace", metavar="TRACE", help=traces)
    names = f"{', '.join(NAMES)}, fixed:J (level J) or fixed:RUNG (default: %(default)s)"
    parser.add_argument("--policy", default=DEFAULT_POLICY, help=names)
    link = parser.add_argument_group("link")
    trip = f"round trip (default: the trace's, else {1e3 * DEFAULT_RTT_S:g})"
    link.add_argument("--rtt", type=float, metavar="MS", help=trip)
    link.add_argument("--offset", type=float, default=0.0, metavar="S", help="where in the trace to begin (default: 0)")
    link.add_argument("--scale", type=float, default=1.0, help="factor on the trace's rates (default: 1, as measured)")
    link.add_argument("--end", choices=ENDS, default="loop", help="what follows the trace's last second")
    _add_player_options(parser)
    http = parser.add_argument_group("http, for a URL")
    http.add_argument("--as-fast", action="store_true", help=about(HttpSettings, "as_fast"))
    words = f"{about(HttpSettings, 'timeout_s')} (default: %(default)g)"
    http.add_argument("--timeout", type=float, default=HttpSettings().timeout_s, metavar="S", help=words)
    study = parser.add_argument_group("study")
    study.add_argument("--compare", action="store_true", help="policies against each other on --traces")
    study.add_argument("--traces", nargs="+", default=[], metavar="DIR|TRACE", help="folders of traces, or traces")
    study.add_argument("--offsets", type=int, default=8, help="starts in each trace, drawn from --seed (default: 8)")
    study.add_argument("--policies", default=",".join(COMPARED), help=f"default: {','.join(COMPARED)}")
    study.add_argument("--seed", type=int, default=1)
    study.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    out = parser.add_argument_group("output")
    add_views(out, "cameras that the viewer goes by", "the viewing region")
    out.add_argument("--original", metavar="SEQUENCE", help="shown beside the screen in --video")
    add_baking(out)
    out.add_argument("--report", type=Path, metavar="DIR", help="write pictures and a page")
    out.add_argument("--video", type=Path, metavar="OUT.mp4", help="film what was on the screen")
    add_device(out, "where pictures are drawn")
    out.add_argument("--json", action="store_true", help="print the figures as JSON")
    return parser


def _add_player_options(parser: argparse.ArgumentParser) -> None:
    """Options for the fields of SessionSettings, which say what they mean and their defaults."""
    player = parser.add_argument_group("player")
    defaults = SessionSettings()
    seconds = ("--buffer", "buffer_s"), ("--view-buffer", "view_buffer_s"), ("--startup", "startup_s")
    for option, name in (*seconds, ("--resume", "resume_s")):
        words = f"{about(SessionSettings, name)} (default: %(default)g)"
        player.add_argument(option, dest=name, type=float, default=getattr(defaults, name), metavar="S", help=words)
    milliseconds = f"{1e3 * defaults.decode_frame_s:g}"
    words = f"{about(SessionSettings, 'decode_frame_s')}, or measure (default: %(default)s)"
    player.add_argument("--decode-ms", default=milliseconds, metavar="MS", help=words)
    for option, name in (("--no-replace", "replace"), ("--no-abandon", "abandon"), ("--no-pipelining", "pipelined")):
        words = f"do not {about(SessionSettings, name)}"
        player.add_argument(option, dest=name, action="store_false", help=words)
    player.add_argument("--loops", type=int, help=about(SessionSettings, "loops"))
    player.add_argument("--budget", type=int, metavar="N", help=about(SessionSettings, "budget"))
    words = "fetch the tiles that the viewer is expected to see, who walks as in --video"
    player.add_argument("--view-adaptive", action="store_true", help=words)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-play", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    if args.report:
        require_matplotlib("--report")
        if args.report.exists() and not args.report.is_dir():
            raise ConfigError(f"{args.report}: expected a folder for the report, got a file")
    if args.compare and (args.budget is not None or args.view_adaptive):
        option = "--view-adaptive" if args.budget is None else "--budget"
        raise ConfigError(f"{option}: expected a single session, got --compare")
    if args.package.startswith(("http://", "https://")):
        return _over_http(args)
    if args.as_fast:
        raise ConfigError(f"--as-fast: expected a URL, got {args.package}; a simulated session takes no time")
    package = open_package(args.package)
    if args.compare:
        return _compare(package, args)
    if not args.trace:
        raise ConfigError("expected --trace, or --compare with --traces")
    if args.rtt is not None and not (math.isfinite(args.rtt) and args.rtt >= 0):
        raise ConfigError(f"--rtt: expected a round trip of 0 ms or more, got {args.rtt:g}")
    trace = open_trace(args.trace).cut(args.offset, args.scale).ending(args.end)
    link = Link.over(trace, None if args.rtt is None else args.rtt / 1e3)
    return _session(package, link, args)


def _over_http(args: argparse.Namespace) -> int:
    if args.trace or args.compare:
        raise ConfigError("a URL is played over the real connection: expected no --trace and no --compare")
    pictures = args.report or args.video
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="airgs-")))
        keep = Folder(folder).write if pictures else None
        http = HttpSettings(timeout_s=args.timeout, as_fast=args.as_fast)
        downloader = stack.enter_context(HttpDownloader(args.package, http, keep))
        settings = _settings(None, args)
        offers = downloader.open()
        log = play(offers, downloader, args.policy, settings, view=_view(offers.manifest, args))
        if pictures:
            fetch_beside(log, downloader)
        _present(Package(Folder(folder), log.offers.manifest, log.offers.root_bytes), log, args)
    return 0


def _settings(package: Package | None, args: argparse.Namespace) -> SessionSettings:
    if args.decode_ms == "measure":
        if package is None:
            raise ConfigError("--decode-ms measure: expected a folder, got a URL")
        decode_s = measure_decoding(package)
    else:
        try:
            decode_s = float(args.decode_ms) / 1e3
        except ValueError as error:
            raise ConfigError(f"--decode-ms: expected milliseconds or measure, got {args.decode_ms}") from error
    names = ("buffer_s", "view_buffer_s", "startup_s", "resume_s", "replace", "abandon", "pipelined", "loops", "budget")
    return SessionSettings(decode_frame_s=decode_s, **{name: getattr(args, name) for name in names})


def _session(package: Package, link: Link, args: argparse.Namespace) -> int:
    settings, faults = _settings(package, args), find_faults(package)
    log = simulate(package, link, args.policy, settings, faults, view=_view(package.manifest, args))
    _present(package, log, args)
    return 0


def _view(m: Manifest, args: argparse.Namespace) -> View | None:
    """The way of a viewer by whom tiles are fetched; None where all are."""
    if not args.view_adaptive:
        return None
    return path_of(m, read_cameras(args.views) if args.views else [])


def _present(package: Package, log: SessionLog, args: argparse.Namespace) -> None:
    """Make the pictures and print the figures that were asked for."""
    original = open_sequence(args.original, **told_baking(args)) if args.original else None
    viewer = _viewer(log, args) if args.report or args.video else None
    if args.report and viewer:
        args.report.mkdir(parents=True, exist_ok=True)
        write_png(args.report / "screen.png", still(package, log, viewer.cameras[0], viewer.renderer))
        write_report(log, args.report, viewer)
    if args.video and viewer:
        bar = Bar(args.json)
        film(package, log, viewer, args.video, original, bar)
        bar.close()
    said = {"policy": log.policy, "lost": log.lost, "retried": log.retried}
    record = dataclasses.asdict(log.metrics) | said | place_record(log, viewer)
    print(to_json(record) if args.json else _as_words(log, viewer, args))


def _viewer(log: SessionLog, args: argparse.Namespace) -> Viewer:
    cameras = read_cameras(args.views) if args.views else []
    if all(shown.rung is None for shown in log.shown):
        raise ConfigError(f"{args.package}: nothing can be shown: {'; '.join(log.lost)}")
    walked = before_background(log.offers.manifest.region, cameras)
    return Viewer.of(log, walked, open_renderer(args.device))


def _as_words(log: SessionLog, viewer: Viewer | None, args: argparse.Namespace) -> str:
    report = f"\n{'report':<22}{args.report / 'index.html'}" if args.report else ""
    film_line = f"\n{'film':<22}{args.video}" if args.video else ""
    return format_metrics(log, viewer) + report + film_line


def _compare(package: Package, args: argparse.Namespace) -> int:
    if not args.traces:
        raise ConfigError("--compare: expected --traces with folders of traces, or traces")
    traces: list[str] = []
    for text in args.traces:
        folder = Path(text)
        found = sorted(str(p) for p in folder.iterdir() if p.is_file()) if folder.is_dir() else [text]
        if not found:
            raise ConfigError(f"{folder}: expected a folder with traces, got an empty one")
        traces += found
    c = Offers(package.manifest)
    policies = tuple(name for name in args.policies.split(",") if name)
    for name in policies:
        make_policy(name, c, Link(open_trace("const:1")))
    settings = StudySettings(
        policies,
        tuple(traces),
        args.offsets,
        args.scale,
        args.end,
        None if args.rtt is None else args.rtt / 1e3,
        args.seed,
        _settings(package, args),
        args.jobs,
    )
    bar = Bar(args.json)
    study = run_study(args.package, settings, bar)
    bar.close()
    if args.report:
        write_study(study, args.report)
    print(format_study(study, args.json))
    if args.report and not args.json:
        print(f"report: {args.report / 'index.html'}")
    return 0
