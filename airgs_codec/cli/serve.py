"""airgs-serve: packages over HTTP."""

from __future__ import annotations

import asyncio
import signal
import socket
from contextlib import suppress
from functools import partial
from pathlib import Path
from urllib.parse import quote

from airgs_codec._settings import required, setting
from airgs_codec.cli.options import as_options, run_program
from airgs_codec.cli.terminal import say
from airgs_codec.errors import ConfigError
from airgs_codec.serve.app import Packages, check_certificate, listen, make_app
from airgs_codec.serve.app import serve as serve_app
from airgs_codec.serve.pages import NOT_BUILT, is_built, player_address

SERVED = "folder with airgs.json, or a folder that holds such folders: new ones are served, too, as they appear"
ANY_HOST = ("0.0.0.0", "::")


@as_options
class Serve:
    packages: tuple[Path, ...] = required(SERVED)
    host: str = setting("127.0.0.1", "address to listen at; 0.0.0.0: all")
    port: int = setting(8000, "port to listen at, 0: any free one")
    certificate: Path | None = setting(None, "certificate chain, for https with HTTP/2; needs --key", metavar="PEM")
    key: Path | None = setting(None, "key of the certificate", metavar="PEM")


def serve(options: Serve) -> int:
    """Serve packages over HTTP, each below its name."""
    packages = Packages(list(options.packages))
    if bool(options.certificate) != bool(options.key):
        raise ConfigError("expected --certificate and --key together")
    certificate = (options.certificate, options.key) if options.certificate and options.key else None
    if certificate:
        check_certificate(*certificate)
    listening = listen(options.host, options.port)
    with suppress(ImportError, ValueError):  # Windows has none; macOS says "no limit" and refuses to set it
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)  # open files that the system lets this process have
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    say(_greeting(packages, listening, "https" if certificate else "http"))
    asyncio.run(_serve(packages, listening, certificate))
    say("stopped")
    return 0


async def _serve(packages: Packages, listening: socket.socket, certificate: tuple[Path, Path] | None) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await serve_app(make_app(packages), listening, stop, certificate)


def _greeting(packages: Packages, listening: socket.socket, scheme: str) -> str:
    host, port = listening.getsockname()[:2]
    names = sorted(packages.now())
    address = _address(scheme, host, port)
    local = _address(scheme, "localhost" if host in ANY_HOST else host, port)
    if not names:
        return f"serving {address}/\nno package yet: each is served as it appears; open {local}/"
    opened = [f"open {local}{player_address(name)}" for name in names] if is_built() else [NOT_BUILT]
    return "\n".join([f"serving {address}/", *(f"{address}/{quote(name)}/" for name in names), *opened])


def _address(scheme: str, host: str, port: int) -> str:
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"


main = partial(run_program, "airgs-serve", serve)
