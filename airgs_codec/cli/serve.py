"""airgs-serve: packages over HTTP, at full speed or over a shaped link."""

from __future__ import annotations

import argparse
import asyncio
import logging
import resource
import signal
import socket
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from airgs_codec.cli.common import run_command
from airgs_codec.errors import ConfigError
from airgs_codec.play.trace import Link, Trace, open_trace
from airgs_codec.serve.app import make_app
from airgs_codec.serve.files import PackageFiles
from airgs_codec.serve.pages import NOT_BUILT, is_built, player_address
from airgs_codec.serve.server import Certificate, ServerSettings, Shape, check_certificate, listen, serve

PACKAGES = "folder with airgs.json, or a folder that holds such folders: new ones are served, too, as they appear"
ANY_HOST = ("0.0.0.0", "::")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="airgs-serve", description="Serve packages over HTTP, each below its name.")
    parser.add_argument("packages", type=Path, nargs="+", metavar="PACKAGE", help=PACKAGES)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen at; 0.0.0.0: all (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8000, help="0: any free one (default: %(default)s)")
    parser.add_argument("--verbose", action="store_true", help="a line on stderr for every request")
    link = parser.add_argument_group("link, shared by all connections")
    traces = "rates that answers pass at, from the first request on; what airgs-play takes for --trace"
    link.add_argument("--trace", metavar="TRACE", help=traces)
    words = "how late requests arrive (default: as airgs-play with --trace, else 0)"
    link.add_argument("--rtt", type=float, metavar="MS", help=words)
    tls = parser.add_argument_group("https, with HTTP/2")
    tls.add_argument("--certificate", type=Path, metavar="PEM", help="certificate with its chain; needs --key")
    tls.add_argument("--key", type=Path, metavar="PEM", help="key of the certificate")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = _parser().parse_args(argv)
    return run_command("airgs-serve", lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    files = PackageFiles(args.packages)
    shape, certificate = _shape(args), _certificate(args)
    settings = ServerSettings(shape, certificate, access_log=_access_log() if args.verbose else None)
    listening = listen(args.host, args.port, settings.patience_s)
    _allow_connections()
    print(_greeting(files, listening, "https" if certificate else "http"), flush=True)
    asyncio.run(_serve_until_signal(files, listening, settings))
    print("stopped")
    return 0


def _allow_connections() -> None:
    """As many open files as the system lets this process have."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


async def _serve_until_signal(files: PackageFiles, listening: socket.socket, settings: ServerSettings) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await serve(make_app(files), listening, settings, stop)


def _shape(args: argparse.Namespace) -> Shape | None:
    if args.trace is None and args.rtt is None:
        return None
    trace: Trace | None = open_trace(args.trace) if args.trace is not None else None
    rtt_s = None if args.rtt is None else args.rtt / 1e3
    link = Link.over(trace or open_trace("const:1"), rtt_s)  # checks the round trip
    return Shape(trace, link.rtt_s)


def _certificate(args: argparse.Namespace) -> Certificate | None:
    if args.certificate is None and args.key is None:
        return None
    if args.certificate is None or args.key is None:
        raise ConfigError("expected --certificate and --key together")
    certificate = Certificate(args.certificate, args.key)
    check_certificate(certificate)
    return certificate


def _access_log() -> logging.Logger:
    log = logging.getLogger("airgs_codec.serve.access")
    log.setLevel(logging.INFO)
    log.propagate = False
    handler = logging.StreamHandler()
    handler.setFormatter(_Printable())
    log.handlers = [handler]
    return log


class _Printable(logging.Formatter):
    """One line a record: what a client sent cannot break it, or speak to the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return "".join(c if c.isprintable() else "?" for c in super().format(record))


def _greeting(files: PackageFiles, listening: socket.socket, scheme: str) -> str:
    """Where the server and the packages are, then what to open in a browser."""
    host, port = listening.getsockname()[:2]
    names = sorted(files.packages)
    address = _address(scheme, host, port)
    local = _address(scheme, "localhost" if host in ANY_HOST else host, port)
    opened = [f"open {local}{player_address(name)}" for name in names] if is_built() else [NOT_BUILT]
    return "\n".join([f"serving {address}/", *(f"{address}/{quote(name)}/" for name in names), *opened])


def _address(scheme: str, host: str, port: int) -> str:
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"
