"""What commands say on a terminal: answers, errors as one line, progress; and how they end."""

from __future__ import annotations

import io
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

from airgs_codec.errors import AirgsError
from airgs_codec.places.whole import naming
from airgs_codec.progress import about, name_of

# OpenMP threads of numba spin while they wait, unless this is set before the first import that loads them.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

LINE_S = 30.0  # between two lines of progress in a log
TRUSTED = 0.1  # of what was expected: by then what is seen says as much
MOST_GUESSED = 0.9  # of a part of which nothing is heard
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


class Whole:
    """How far all stages of a work are: as expected, a share of which is `trusted`, until it goes otherwise."""

    def __init__(self, seconds: Mapping[str, float], trusted: float = 0.0) -> None:
        self._seconds, self._total, self._share, self._over = seconds, sum(seconds.values()), 0.0, 0.0
        self._trusted, self._part = trusted * self._total, next(iter(seconds.values()))
        self._begun_s = self._since_s = time.monotonic()

    def report(self, stage: str, done: int, total: int) -> None:
        """Take how far a stage is. One that nobody expected, or that is over, changes nothing."""
        if own := self._seconds.get(name := name_of(stage)):
            before = sum(list(self._seconds.values())[: list(self._seconds).index(name)])
            if (over := before + own * done / total) >= self._over:
                self._over, self._part, self._since_s = over, own * (done < total) / total, time.monotonic()

    def look(self) -> tuple[float, float]:
        """Return the share of the time that is over, which only grows, and about how many seconds are left."""
        spent_s, quiet_s = (time.monotonic() - since_s for since_s in (self._begun_s, self._since_s))
        if not (over := self._over + self._trusted):
            return 0.0, math.inf
        if self._trusted:  # it goes on as before while nothing is heard of it
            over += min(MOST_GUESSED * self._part, quiet_s * over / (spent_s - quiet_s + self._trusted))
        left_s = max(0.0, self._total + self._trusted - over) * (spent_s + self._trusted) / over
        self._share = max(self._share, spent_s / (spent_s + left_s) if left_s else 1.0)
        return self._share, left_s


class Bar(AbstractContextManager["Bar"]):
    """A bar for each stage of a work, or one for all where it is known what to expect; or `quiet`.

    Where stderr is no terminal, a line at most every LINE_S.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet, self._stage, self._words, self._seconds = quiet, "", "", dict[str, float]()
        self._piped = sys.stderr is None or not sys.stderr.isatty()  # None: it is closed
        self._whole, self._bar = Whole({"": 1.0}), None
        self._begun_s = self._said_s = time.monotonic()
        self._lock, self._over = threading.RLock(), threading.Event()

    def expect(self, what: str, seconds: dict[str, float], size: float) -> None:
        """Show one bar for stages of so many seconds; when the first begins, say what is expected, and the bytes."""
        time_words, megabytes = about(sum(seconds.values())), float(f"{size / 1e6:.2g}")
        self._seconds, self._words = seconds, f"{what}: will take {time_words} and {megabytes:g} MB"

    def __call__(self, stage: str, done: int, total: int) -> None:
        if self.quiet:
            return
        if self._words:
            warn(self._words)
            self._words, self._whole = "", Whole(self._seconds, TRUSTED)
            threading.Thread(target=self._go_on, daemon=True).start()
        with self._lock:
            if not self._seconds and name_of(stage) != name_of(self._stage):
                self._whole = Whole({name_of(stage): 1.0})
            self._stage, self._bar = stage, self._bar or (None if self._piped else _tqdm(stage))
            self._whole.report(stage, done, total)
            self._show()
            if self._whole.look()[0] == 1.0:
                self._seconds = {}  # what comes now has a bar of its own

    def _go_on(self) -> None:
        with suppress(OSError):  # nobody reads stderr any more
            while not self._over.wait(1.0):
                with self._lock:
                    self._show()

    def _show(self) -> None:
        (share, left_s), now_s = self._whole.look(), time.monotonic()
        left = f", {about(left_s)} left" if 1 <= left_s < math.inf else ""
        if self._bar is not None:
            self._bar.set_description_str(_plain(f"{self._stage}: {share:.0%}{left}"), refresh=False)
            self._bar.update(share - self._bar.n)
        elif self._piped and now_s - self._said_s >= LINE_S and not self._over.is_set():
            self._said_s = now_s
            warn(f"{self._stage}: {share:.0%} after {now_s - self._begun_s:.0f} s{left}")

    def close(self) -> None:
        """Take the bar off the terminal until more is heard."""
        with self._lock:
            if self._bar is not None:
                self._bar.close()
            self._bar = None

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.close()


def _tqdm(stage: str) -> Any:
    from tqdm import tqdm  # 0.1 s, which a command without long work need not wait for

    columns = os.get_terminal_size(sys.stderr.fileno()).columns or NARROW
    how = {"ncols": columns, "nrows": 2, "bar_format": "{desc} |{bar}|"}  # one line, whatever the terminal says it has
    return tqdm(total=1.0, desc=_plain(stage), leave=False, **how)
