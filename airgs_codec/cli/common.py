"""What every command shares: errors as one line, progress on stderr, frame ranges."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

from tqdm import tqdm

from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.scene.sequence_json import MAX_FPS, exact_number

# OpenMP threads of numba spin while they wait unless told so before the first import that loads them.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


PACKAGE = "a package: its folder, or its address, s3://, gs:// or az://"


class _Terminated(KeyboardInterrupt):
    """SIGTERM came."""


def run_command(name: str, work: Callable[[], int]) -> int:
    """Exit status of a command: bad input or a failing disk is one line on stderr and 2, a bug keeps its traceback.

    SIGINT and SIGTERM end the work where it is, so that it removes what it has begun; the status is 130 or 143.
    """
    try:
        with _terminable():
            return work()
    except AirgsError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        print(f"{name}: stopped", file=sys.stderr)
        return 128 + (signal.SIGTERM if isinstance(error, _Terminated) else signal.SIGINT)
    except BrokenPipeError:  # the reader of our output has gone, `| head` for one
        sys.stderr.close()
        return 0
    except OSError as error:
        what = error.strerror or f"{error} (is the disk full?)"  # numpy counts bytes instead of asking
        print(f"{name}: {error.filename or 'file system'}: {what}", file=sys.stderr)
        return 2


@contextmanager
def _terminable() -> Iterator[None]:
    """Within the block SIGTERM raises _Terminated, unless this is a thread of somebody's program."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: Any) -> None:
        raise _Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def fraction(text: str) -> Fraction:
    """The type of an option that is an exact number, as 30, 29.97 or 30000/1001."""
    try:
        return exact_number(text)
    except (ValueError, ZeroDivisionError) as error:
        raise argparse.ArgumentTypeError(f"expected a number or a fraction, got {text!r}") from error


def expect_rate(option: str, fps: Fraction | None) -> None:
    """Raise ConfigError where an option is no number of frames a second."""
    if fps is not None and not 0 < fps <= MAX_FPS:
        raise ConfigError(f"{option}: expected 0 < fps <= {MAX_FPS}, got {fps}")


class Bar:
    """A progress bar for each stage of a long work; silent where stderr is no terminal or `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet or not sys.stderr.isatty()
        self._bar: tqdm | None = None
        self._stage = ""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of `total` parts of a stage are finished."""
        if self._quiet:
            return
        if stage != self._stage:
            self.close()
            self._stage = stage
            self._bar = tqdm(total=total, desc=stage, leave=False)
        if self._bar is not None:
            self._bar.update(done - self._bar.n)

    def close(self) -> None:
        """Clear the line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def add_views(parser: argparse._ActionsContainer, purpose: str, default: str) -> None:
    """The option --views; `purpose` says what the cameras are for, `default` which are taken without it."""
    forms = "transforms.json, INRIA's cameras.json, COLMAP's sparse/, Panoptic's train_meta.json, poses_bounds.npy"
    words = f"{purpose}: a file or folder of any form ({forms}, .splatv, .4dgs; default: {default})"
    parser.add_argument("--views", type=Path, metavar="PATH", help=words)


def add_device(parser: argparse._ActionsContainer, purpose: str) -> None:
    """The option --device; `purpose` says what the device is for."""
    from airgs_codec.render.backend import DEVICES  # loads numba, for which OMP_WAIT_POLICY must have been set

    words = f"{purpose}: cuda needs a GPU and the cuda extra (default: auto, cuda where it can)"
    parser.add_argument("--device", choices=DEVICES, default="auto", help=words)


def parse_frames(text: str | None) -> tuple[int, int | None]:
    """First frame and the one after the last of A:B, A:, :B or a single number; None stands for the end.

    Without text, all frames. Raises ConfigError.
    """
    head, colon, tail = (text or ":").partition(":")
    try:
        start = int(head) if head else 0
        return start, (int(tail) if tail else None) if colon else start + 1
    except ValueError as error:
        raise ConfigError(f"--frames: expected A:B, got {text!r}") from error


def parse_range(text: str, frames: int) -> tuple[int, int]:
    """(start, stop) as `parse_frames` gives it, of a sequence of `frames`. Raises ConfigError."""
    start, stop = parse_frames(text)
    stop = frames if stop is None else stop
    if not 0 <= start < stop <= frames:
        raise ConfigError(f"--frames: expected A:B inside 0:{frames}, got {text!r}")
    return start, stop
