"""A web server that does what servers, links and caches do on bad days."""

import random
import socket
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http.server import BaseHTTPRequestHandler
from pathlib import Path

from tests.faces import REPR_DIGEST, repr_digest
from tests.support.servers import answering

FAULTS = ("drop", "truncation", "stall", "wrong bytes", "wrong length", "status", "garbage", "wrong file")
ROOT = "airgs.json"


@dataclass
class Weather:
    share: float  # of the answers
    kinds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(FAULTS, 1.0))  # fault -> its weight
    seed: int = 1
    stall_s: float = 1.0
    done: Counter[str] = field(default_factory=Counter)  # faults so far
    lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def choose(self) -> str:
        with self.lock:
            if self._random.random() >= self.share:
                return ""
            fault = self._random.choices(list(self.kinds), list(self.kinds.values()))[0]
            self.done[fault] += 1
            return fault

    def place(self, size: int) -> int:
        with self.lock:
            return self._random.randrange(size)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def __init__(self, folder: Path, weather: Weather, ended: threading.Event, *args: object) -> None:
        self._folder, self._weather, self._ended = folder, weather, ended
        super().__init__(*args)  # type: ignore[arg-type]

    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""

    def do_GET(self) -> None:
        if self._ended.is_set():
            self._break()
            return
        path = self._folder / self.path.lstrip("/")
        if not path.is_file():
            self.send_error(404)
            return
        data, fault = path.read_bytes(), self._weather.choose()
        head = {REPR_DIGEST: repr_digest(data)} if path.name == ROOT else {}
        if fault == "drop":
            self._break()
        elif fault == "garbage":
            self.wfile.write(b"\x00\xffnot HTTP at all\r\n\r\n" + data[:100])
            self._break()
        elif fault == "status":
            self._answer(b"sorry\n", {}, 503 if self._weather.place(2) else 500)
        elif fault in ("truncation", "stall"):
            self._answer(data[: self._weather.place(len(data))], head | {"Content-Length": str(len(data))})
            if fault == "stall":
                self._ended.wait(self._weather.stall_s)
            self._break()
        else:
            self._answer(_altered(fault, data, self._weather.place(len(data)), path), head)

    def _answer(self, body: bytes, headers: dict[str, str], status: int = 200) -> None:
        self.send_response_only(status)
        for name, value in ({"Content-Length": str(len(body))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _break(self) -> None:
        self.close_connection = True
        self.connection.shutdown(socket.SHUT_RDWR)


def _altered(fault: str, data: bytes, at: int, path: Path) -> bytes:
    if fault == "wrong bytes":
        return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]
    if fault == "wrong length":
        return data[:at] if at % 2 else data + data[: at + 1]
    if fault == "wrong file":
        others = sorted(other for other in path.parent.iterdir() if other.is_file() and other != path)
        return others[at % len(others)].read_bytes() if others else data[::-1]
    return data


@contextmanager
def faultily_serving(folder: Path, weather: Weather, port: int = 0) -> Iterator[int]:
    ended = threading.Event()
    with answering(partial(_Handler, folder, weather, ended), port) as port:
        try:
            yield port
        finally:
            ended.set()
