"""Rate and distortion of airgs beside published layouts and formats, in one run over the same rows, views and frames.

    python -m tools.bench_rd SEQUENCE --views transforms.json -o PREFIX [--fps 24]
        [--splat-transform COMMAND] [--splat4d COMMAND] [--fourdgs PYTHON]

Writes PREFIX.csv and PREFIX.png, and prints every point, a Markdown table and the machine. PSNR is measured against
renderings of the input, pooled over the test cameras and `--frames` frames of the sequence; where transforms.json names
pictures of these cameras and frames, PSNR against them stands beside it. The re-implemented layouts
(tools/rd/layouts.py) run at the preset of x264 and x265 that airgs uses, veryslow, and at medium. The other coders are
given all rows, in Morton order; "airgs, keeps all" drops none. BD-rate spans only the PSNR that both curves cover;
negative is smaller.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before numba: threads that wait must not take a core

from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.render import read_cameras
from airgs_codec.scene.sequence import open_sequence
from tools.rd import report
from tools.rd.coders import layout_trials, our_trials
from tools.rd.points import RdPoint
from tools.rd.programs import fourdgs_trials, splat4d_trials, splat_transform_trials
from tools.rd.subject import Subject, Trial, open_subject, pooled_psnr

TARGETS = "47,45.5,44,42.5,41,39.5"  # dB, of our packages


def trials(args: argparse.Namespace) -> Iterator[Trial]:
    """Everything that is asked for, ours first."""
    targets = [float(part) for part in args.targets.split(",")]
    yield from our_trials(targets, keep_all=False)
    yield from our_trials(targets, keep_all=True)
    yield from layout_trials()
    if args.splat4d:
        yield from splat4d_trials(args.splat4d)
    if args.fourdgs:
        yield from fourdgs_trials(args.fourdgs)
    if args.splat_transform:
        yield from splat_transform_trials(args.splat_transform)


def run(subject: Subject, wanted: Iterator[Trial]) -> Iterator[RdPoint]:
    """Every trial that could be met; of the others, why not."""
    for trial in wanted:
        try:
            point = subject.point(trial)
        except ConfigError as error:
            print(f"{trial.coder}, {trial.setting}: {error}", flush=True)
            continue
        print(report.format_point(point), flush=True)
        yield point


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--views", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PREFIX")
    parser.add_argument("--fps", type=Fraction)
    parser.add_argument("--frames", type=int, default=6, help="frames measured (default: 6)")
    parser.add_argument("--targets", default=TARGETS, help=f"PSNR of our packages, dB (default: {TARGETS})")
    parser.add_argument("--range", default="41:46", help="PSNR range of the BD-rate, dB (default: 41:46)")
    parser.add_argument("--splat-transform", metavar="COMMAND", help="such as 'splat-transform -g cpu'")
    parser.add_argument("--splat4d", metavar="COMMAND", help="the program of the PyPI package splats4d")
    parser.add_argument("--fourdgs", metavar="PYTHON", help="of an environment with the PyPI package fourdgs")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Run everything, write and print."""
    args = parse(argv)
    sequence = open_sequence(args.sequence, views=args.views, fps=args.fps)
    cameras = [c for c in read_cameras(args.views) if c.held_out]
    subject = open_subject(sequence, cameras, args.frames, args.views)
    points = list(run(subject, trials(args)))
    args.output.parent.mkdir(parents=True, exist_ok=True)
    report.write_csv(points, args.output.with_suffix(".csv"))
    report.plot(points, args.output.with_suffix(".png"), f"{args.sequence.name}: {len(sequence)} frames")
    low, high = (float(part) for part in args.range.split(":"))
    print(report.markdown(points, low, high), report.COUNTED, sep="\n\n")
    if subject.truth:
        print(
            f"The input itself is {pooled_psnr(subject.references, subject.truth):.2f} dB from pictures of the scene."
        )
    print(f"{report.machine()}; python -m tools.bench_rd {shlex.join(sys.argv[1:] if argv is None else argv)}")


if __name__ == "__main__":
    try:
        main()
    except AirgsError as error:
        sys.exit(f"bench_rd: {error}")
