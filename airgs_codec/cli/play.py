"""airgs-play: a package over a bandwidth trace."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from airgs_codec.cli.common import Bar, run_command
from airgs_codec.decode import decode_frame
from airgs_codec.errors import ConfigError
from airgs_codec.measure import measured_views
from airgs_codec.package import Package, open_package
from airgs_codec.picture import write_png
from airgs_codec.play.link import DEFAULT_RTT_S, Link
from airgs_codec.play.policy import parse_policy
from airgs_codec.play.report import format_metrics, write_report
from airgs_codec.play.screen import film, still
from airgs_codec.play.session import SessionLog, SessionSettings, metrics, simulate
from airgs_codec.play.trace import read_trace
from airgs_codec.render import Camera, read_cameras
from airgs_codec.render.views import orbit_views


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="airgs-play", description="Simulate a viewer of a package over a trace.")
    parser.add_argument("package", type=Path)
    parser.add_argument("--trace", type=Path, required=True, help="Raca CSV, time_s,mbps CSV or mahimahi")
    parser.add_argument("--policy", default="paper", help="paper (Algorithm 1) or fixed:J (level J) (default: paper)")
    parser.add_argument("--rtt", type=float, default=1e3 * DEFAULT_RTT_S, metavar="MS", help="round trip (default: 80)")
    parser.add_argument(
        "--offset", type=float, default=0.0, metavar="S", help="where in the trace to begin (default: 0)"
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="factor on the trace's rates (default: 1, as measured)"
    )
    parser.add_argument("--buffer", type=float, default=10.0, metavar="S", help="most media ahead (default: 10)")
    parser.add_argument("--loops", type=int, help="times the sequence is played (default: about 30 s of play)")
    parser.add_argument("--views", type=Path, metavar="FILE", help="cameras to look from (default: generated)")
    parser.add_argument("--report", type=Path, metavar="DIR", help="write pictures and a page of the session")
    parser.add_argument("--video", type=Path, metavar="OUT.mp4", help="film what was on the screen")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-play", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    package = open_package(args.package)
    policy, level = parse_policy(args.policy, len(package.manifest.levels))
    link = Link(read_trace(args.trace).cut(args.offset, args.scale), args.rtt / 1e3)
    settings = SessionSettings(policy, level, args.buffer, loops=args.loops)
    log = simulate(package.manifest, package.manifest_bytes, link, settings)
    cameras = _cameras(package, args) if args.report or args.video else []
    if args.report:
        _report(package, log, cameras, args.report)
    if args.video:
        bar = Bar(args.json)
        film(package, log, cameras, args.video, bar)
        bar.close()
    result = metrics(log) | {"policy": args.policy}
    print(json.dumps(result) if args.json else _as_words(log, args))
    return 0


def _cameras(package: Package, args: argparse.Namespace) -> list[Camera]:
    if args.views:
        return measured_views(read_cameras(args.views))
    return orbit_views(decode_frame(package, 0), size=320)


def _report(package: Package, log: SessionLog, cameras: Sequence[Camera], directory: Path) -> None:
    if directory.exists() and not directory.is_dir():
        raise ConfigError(f"{directory}: expected a folder for the report, got a file")
    directory.mkdir(parents=True, exist_ok=True)
    write_png(directory / "screen.png", still(package, log, cameras[0]))
    write_report(log, directory)


def _as_words(log: SessionLog, args: argparse.Namespace) -> str:
    report = f"\n{'report':<22}{args.report / 'index.html'}" if args.report else ""
    film_line = f"\n{'film':<22}{args.video}" if args.video else ""
    return format_metrics(log) + report + film_line
