"""Options on who does the work: processes of this machine, a Dask cluster, a share of several runs."""

from __future__ import annotations

import argparse
import importlib.util
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from airgs_codec._report import require_matplotlib
from airgs_codec.errors import ConfigError
from airgs_codec.jobs.engines import Engine, InProcess, Processes
from airgs_codec.jobs.work import Part, Work
from airgs_codec.places.results import open_store
from airgs_codec.progress import Progress

DASK = re.compile(r"dask(?::(.+))?")


def add_work(parser: argparse.ArgumentParser, merged: str) -> None:
    """The options --jobs, --executor, --work and --part; `merged`: what makes a whole of the work of all parts."""
    group = parser.add_argument_group("work (docs/farm.md)")
    group.add_argument("--jobs", type=int, default=1, metavar="N", help="processes that share the work (default: 1)")
    group.add_argument(
        "--executor",
        metavar="dask[:ADDRESS]",
        help="a Dask cluster does the work: the one whose scheduler is at ADDRESS, which needs --work, or one of "
        "--jobs processes on this machine",
    )
    group.add_argument(
        "--work",
        metavar="PLACE",
        help="where finished jobs stay, so that a run that was cut off goes on: a folder that all workers see, or "
        "s3://, gs://, az:// and a prefix (default: a temporary folder)",
    )
    group.add_argument(
        "--part",
        type=_part,
        metavar="I/N",
        help=f"one of N runs that share --work, counted from 1, which do the jobs together; {merged}",
    )


def shared_by(args: argparse.Namespace) -> str | None:
    """The first of these options that is given; None where one process does everything by itself."""
    given = {"--jobs": args.jobs != 1, "--executor": args.executor, "--work": args.work, "--part": args.part}
    return next((name for name, value in given.items() if value), None)


def _part(text: str) -> Part:
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise argparse.ArgumentTypeError(f"expected I/N with 1 <= I <= N, got {text!r}")
    return Part(int(found[1]) - 1, int(found[2]))


@contextmanager
def told_work(args: argparse.Namespace, progress: Progress) -> Iterator[Work]:
    """What the options ask for, until the block ends. Raises ConfigError for options that cannot work."""
    if args.jobs < 1:
        raise ConfigError(f"--jobs: expected at least one process, got {args.jobs}")
    if args.part and not args.work:
        raise ConfigError("--part: expected --work, a place that all parts share, got none")
    if args.report:
        require_matplotlib("--report")
    with tempfile.TemporaryDirectory(prefix="airgs-work-") as folder:
        store = open_store(args.work) if args.work else open_store(Path(folder), lasting=False)
        engine = _engine(args)
        try:
            yield Work(store, engine, args.part or Part(), progress)
        finally:
            engine.close()


def _engine(args: argparse.Namespace) -> Engine:
    if args.executor is None:
        return Processes(args.jobs) if args.jobs > 1 else InProcess()
    found = DASK.fullmatch(args.executor)
    if not found:
        raise ConfigError(f"--executor: expected dask or dask:ADDRESS, got {args.executor!r}")
    if found[1] and not args.work:
        raise ConfigError("--executor dask:ADDRESS: expected --work, a place that all workers see, got none")
    if importlib.util.find_spec("distributed") is None:
        raise ConfigError("--executor dask needs Dask: pip install 'airgs-codec[farm]'")
    from airgs_codec.jobs.dask_engine import DaskEngine

    return DaskEngine.at(found[1]) if found[1] else DaskEngine.local(args.jobs)
