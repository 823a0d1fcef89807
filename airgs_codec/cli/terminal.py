"""What commands say on a terminal: answers, errors as one line, progress; and how they end."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airgs_codec.errors import AirgsError
from airgs_codec.places.whole import naming
from airgs_codec.progress import Bars, Progress, about, name_of, silent

if TYPE_CHECKING:
    from tqdm import tqdm

# OpenMP threads of numba spin while they wait, unless this is set before the first import that loads them.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

LINE_S = 10.0  # between two lines of progress in a log
NARROW = 80  # columns of a terminal that does not know how many it has


def run_command(name: str, work: Callable[[], int]) -> int:
    """Return the exit status of a command: 2 and a line on stderr for bad input or a failing disk.

    SIGINT and SIGTERM end the work where it is, so that it removes what it has begun; the status is 130 or 143.
    """
    for stream in filter(None, (sys.stdout, sys.stderr)):
        if isinstance(stream, io.TextIOWrapper):  # of characters that its encoding does not have
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
    """Print a command's answer, without control characters: parts of it may come from foreign files."""
    with naming(Path("standard output")):
        print(_plain(text), end=end, flush=True)


def warn(text: str, end: str = "\n") -> None:
    """Print on stderr what is not part of the answer."""
    print(_plain(text), end=end, file=sys.stderr, flush=True)


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


class Bar(Bars, AbstractContextManager["Bar"]):
    """A progress bar for each stage of a long work; a line every LINE_S where stderr is no terminal; or `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        super().__init__(_tqdm)
        piped = sys.stderr is None or not sys.stderr.isatty()  # None: it is closed
        self._show: Progress = silent if quiet else _lines() if piped else super().__call__

    def __call__(self, stage: str, done: int, total: int) -> None:
        self._show(stage, done, total)

    def __exit__(self, *_: object) -> None:
        self.close()


def _lines() -> Progress:
    """Return what says on stderr how far a stage is, at most every LINE_S."""
    begun_s = said_s = time.monotonic()
    first = ("", begun_s, 0)  # what was first heard of the stage: its name, when, and how much was done

    def say_line(stage: str, done: int, total: int) -> None:
        nonlocal said_s, first
        now_s = time.monotonic()
        first = first if name_of(stage) == first[0] else (name_of(stage), now_s, done)
        if now_s - said_s < LINE_S:
            return
        said_s, (_, since_s, before) = now_s, first
        left_s = (total - done) * (now_s - since_s) / (done - before) if done > before else 0.0
        left = f", {about(left_s)} left" if left_s >= 1 else ""
        warn(f"{stage}: {done} of {total}, after {now_s - begun_s:.0f} s{left}")

    return say_line


def _tqdm(**how: Any) -> tqdm:
    from tqdm import tqdm  # 0.1 s, which a command without long work need not wait for

    return tqdm(leave=False, ncols=os.get_terminal_size(sys.stderr.fileno()).columns or NARROW, **how)
