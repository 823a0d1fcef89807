"""What commands say on a terminal: answers, errors as one line, progress; and how they end."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from airgs_codec.errors import AirgsError
from airgs_codec.places.whole import naming
from airgs_codec.progress import Bars, Progress, about, name_of, silent

if TYPE_CHECKING:
    from tqdm import tqdm

# OpenMP threads of numba spin while they wait unless told so before the first import that loads them.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

LINE_S = 10.0  # between two lines of progress in a log
NARROW = 80  # columns of a terminal that does not know how many it has


def run_command(name: str, work: Callable[[], int]) -> int:
    """Exit status of a command: bad input or a failing disk is one line on stderr and 2, a bug keeps its traceback.

    SIGINT and SIGTERM end the work where it is, so that it removes what it has begun; the status is 130 or 143.
    """
    for stream in filter(None, (sys.stdout, sys.stderr)):
        if isinstance(stream, io.TextIOWrapper):  # whatever its encoding lacks
            stream.reconfigure(errors="backslashreplace")
    own = threading.current_thread() is threading.main_thread()  # else it is a thread of somebody's program
    before = signal.signal(signal.SIGTERM, _stop) if own else None
    try:
        return work()
    except AirgsError as error:
        line = str(error).replace("\n", "\\n")
        warn(f"{name}: {line}")
        return 2
    except KeyboardInterrupt as error:
        warn(f"{name}: stopped")
        return 128 + (error.args[0] if error.args else signal.SIGINT)
    except BrokenPipeError:  # the reader of our output has gone, `| head` for one
        sys.stderr.close()
        return 0
    except OSError as error:
        what = error.strerror or f"{error} (is the disk full?)"  # numpy counts bytes instead of asking
        warn(f"{name}: {error.filename or 'file system'}: {what}")
        return 2
    finally:
        if own:
            signal.signal(signal.SIGTERM, before)


def _stop(number: int, _: Any) -> None:
    raise KeyboardInterrupt(number)


def say(text: str, end: str = "\n") -> None:
    """Print a command's answer; what stands in files that came over a network may not act on a terminal."""
    with naming(Path("standard output")):
        print(_plain(text), end=end, flush=True)


def warn(text: str, end: str = "\n") -> None:
    """Print what is beside the answer, on stderr."""
    print(_plain(text), end=end, file=sys.stderr, flush=True)


def _plain(text: str) -> str:
    """The text with escapes in place of what is no printable character, but for ends of lines."""
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


class Bar:
    """A progress bar for each stage of a long work; a line every LINE_S where stderr is no terminal; or `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        self._bars = Bars(_tqdm)
        piped = sys.stderr is None or not sys.stderr.isatty()  # None: it is closed
        self._show: Progress = silent if quiet else self._say if piped else self._bars
        self._stage = ""
        self._begun_s = self._said_s = time.monotonic()
        self._stage_begun = (0.0, 0)  # when it was first heard of, and how much of it was done then

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of `total` parts of a stage are finished."""
        self._show(stage, done, total)

    def _say(self, stage: str, done: int, total: int) -> None:
        now_s = time.monotonic()
        if name_of(stage) != self._stage:
            self._stage, self._stage_begun = name_of(stage), (now_s, done)
        if now_s - self._said_s >= LINE_S:
            self._said_s = now_s
            begun_s, before = self._stage_begun
            left_s = (total - done) * (now_s - begun_s) / (done - before) if done > before else 0.0
            left = f", {about(left_s)} left" if left_s >= 1 else ""
            warn(f"{stage}: {done} of {total}, after {now_s - self._begun_s:.0f} s{left}")

    def close(self) -> None:
        """Clear the line; a stage may go on."""
        self._bars.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _tqdm(**how: Any) -> tqdm:
    from tqdm import tqdm  # 0.1 s, which a command without long work need not wait for

    return tqdm(leave=False, ncols=os.get_terminal_size(sys.stderr.fileno()).columns or NARROW, **how)
