"""airgs-serve: packages over HTTP, and scenes, which are encoded first."""

from __future__ import annotations

import asyncio
import signal
import socket
import threading
import webbrowser
from contextlib import ExitStack, suppress
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

from airgs_codec._settings import required, setting
from airgs_codec.cli.options import as_options, run_program
from airgs_codec.cli.terminal import say, warn
from airgs_codec.errors import ConfigError, SceneError
from airgs_codec.serve.app import Packages, check_certificate, listen, make_app
from airgs_codec.serve.app import serve as serve_app
from airgs_codec.serve.pages import NOT_BUILT, is_built, player_address
from airgs_codec.serve.scenes import Scenes

SERVED = "package, or folder that holds packages, new ones too, or frames or a clip: they are encoded, --preset fast"
ANY_HOST = ("0.0.0.0", "::")
Pem = tuple[Path, Path]  # a certificate and its key


@as_options
class Serve:
    packages: tuple[Path, ...] = required(SERVED)
    host: str = setting("127.0.0.1", "address to listen at; 0.0.0.0: all")
    port: int = setting(8000, "port to listen at, 0: any free one")
    open: bool = setting(False, "open the page in a browser")
    drop: bool | None = setting(None, "encode files dropped on the list", default="if no other machine is served")
    certificate: Path | None = setting(None, "certificate chain, for https with HTTP/2; needs --key", metavar="PEM")
    key: Path | None = setting(None, "key of the certificate", metavar="PEM")


def serve(options: Serve) -> int:
    """Serve packages over HTTP, each below its name, and scenes when they are encoded."""
    given = [path for path in options.packages if _is_scene(path)]
    folders = [path for path in options.packages if path not in given]
    packages, scenes = Packages(folders), None
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
    dropping = ip_address(listening.getsockname()[0]).is_loopback if options.drop is None else options.drop
    with ExitStack() as stack:
        if given or dropping:
            home = Path(stack.enter_context(TemporaryDirectory(prefix="airgs-serve-"))).resolve()
            packages, scenes = Packages([*folders, home]), Scenes(home, dropping, packages.find, warn)
            for path in given:
                scenes.add(path.resolve())
        page = _greet(packages, bool(given), listening, "https" if certificate else "http")
        if options.open:
            threading.Thread(target=webbrowser.open, args=(page,), daemon=True).start()
        asyncio.run(_serve(packages, scenes, listening, certificate))
    say("stopped")
    return 0


def _is_scene(path: Path) -> bool:
    """Return whether there are frames or a clip at a path, not packages. Raises ConfigError where there is neither."""
    try:
        Packages([path])
    except ConfigError:
        from airgs_codec.scene.formats.table import find_frames  # 0.3 s

        with suppress(SceneError):
            return bool(find_frames(path))
        raise
    return False


async def _serve(packages: Packages, scenes: Scenes | None, listening: socket.socket, certificate: Pem | None) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await serve_app(make_app(packages, scenes), listening, stop, certificate)


def _greet(packages: Packages, encoding: bool, listening: socket.socket, scheme: str) -> str:
    """Say where packages are; returns the address of the page to open."""
    host, port = listening.getsockname()[:2]
    names, address = sorted(packages.now()), _address(scheme, host, port)
    local = _address(scheme, "localhost" if host in ANY_HOST else host, port)
    players = [f"{local}{player_address(name)}" for name in names if not encoding] or [f"{local}/"]
    nothing = "" if names or encoding else "no package yet: each is served as it appears; "
    opened = [f"{nothing}open {page}" for page in players] if is_built() else [NOT_BUILT]
    say("\n".join([f"serving {address}/", *(f"{address}/{quote(name)}/" for name in names), *opened]))
    return players[0] if len(players) == 1 else f"{local}/"


def _address(scheme: str, host: str, port: int) -> str:
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"


main = partial(run_program, "airgs-serve", serve)
