"""Scenes that are no packages yet: airgs-encode makes packages of them, one after the other."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import sys
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PureWindowsPath
from tempfile import mkdtemp
from typing import Any

from airgs_codec.errors import AirgsError, ConfigError
from airgs_codec.package.package import open_package
from airgs_codec.serve.pages import LIST_SCRIPT, escape, title_of

MOST_BYTES = 4 << 30  # of a file that is dropped
ENCODE = "from airgs_codec.cli import encode, terminal; terminal.LINE_S = 0.5; raise SystemExit(encode.main())"
_HOW_FAR = re.compile(r".+: (\d+)% after .*")  # what it says every LINE_S


@dataclass(slots=True, eq=False)
class Scene:
    source: Path
    package: Path
    lines: Sequence[str] = ("waiting",)  # what airgs-encode says, and has decided
    share: float = 0.0  # of the work
    status: int | None = None  # of airgs-encode, when it has ended

    def as_html(self) -> str:
        bar = f"<progress{f' value={self.share:.3f}' if self.share else ''}></progress> " * (self.status is None)
        name, role = escape(title_of(self.package.name)), " role=alert" if self.status else ""
        return "".join(f"<p{role}>{bar}<b>{name}</b>: {escape(line)}</p>\n" for line in self.lines)


class Scenes:
    def __init__(self, home: Path, dropping: bool, find: Callable[[str], object], say: Callable[[str], None]) -> None:
        """`home`: of packages, and of hidden folders; `dropping`: files are taken; `find`: finds packages by name."""
        self.home, self.dropping, self._find, self._say = home, dropping, find, say
        self._scenes: list[Scene] = []
        self._waiting: asyncio.Queue[Scene] = asyncio.Queue()

    def add(self, source: Path) -> str:
        """Have a scene encoded; returns the name of its package, which no other has."""
        stem = (source.name if source.is_dir() else source.stem.removesuffix(".compressed")).lstrip(".") or "scene"
        taken = {scene.package.name for scene in self._scenes}
        names = (f"{stem}{f'-{number}' * (number > 1)}.airgs" for number in count(1))
        name = next(name for name in names if name not in taken and not self._find(name))
        self._scenes.append(Scene(source, self.home / name))
        self._waiting.put_nowait(self._scenes[-1])
        return name

    async def take(self, name: str, body: AsyncIterator[bytes]) -> str:
        """Have a file encoded that is dropped. Raises ConfigError and OSError, and leaves nothing then."""
        name = PureWindowsPath(name).name  # without folders of any system
        if not name.isprintable() or name[:1] in ("", "."):
            raise ConfigError(f"expected the name of a file that is not hidden, got {name!r}")
        self._scenes = [scene for scene in self._scenes if not scene.status]  # what failed was seen
        folder = Path(mkdtemp(dir=self.home, prefix="."))
        try:
            with open(folder / name, "xb") as file:
                async for part in body:
                    await asyncio.to_thread(file.write, part)
            return self.add(folder / name)
        except BaseException:
            shutil.rmtree(folder)
            raise

    @asynccontextmanager
    async def encoding(self, app: Any) -> AsyncIterator[None]:
        """Encode what is added while an application runs."""
        task = asyncio.create_task(self._encode_all())
        yield
        task.cancel()
        await asyncio.wait([task])

    async def _encode_all(self) -> None:
        scene = await self._waiting.get()
        self._say(f"scenes become packages in {self.home}, deleted when this ends; airgs-encode makes some that stay")
        while True:
            try:
                await self._encode(scene)
            except (AirgsError, OSError, ValueError) as error:  # ValueError: a line that is too long
                self._hear(scene, str(error))
                scene.status = 2
            scene = await self._waiting.get()

    async def _encode(self, scene: Scene) -> None:
        """Run airgs-encode in a process that Ctrl-C does not reach; all that it writes is below `home`."""
        words = [sys.executable, "-P", "-c", ENCODE, str(scene.source), "-o", str(scene.package), "--preset", "fast"]
        how: dict[str, Any] = {"stdin": DEVNULL, "stdout": DEVNULL, "stderr": PIPE, "start_new_session": True}
        process = await asyncio.create_subprocess_exec(*words, env=os.environ | {"TMPDIR": str(self.home)}, **how)
        try:
            async for line in process.stderr:  # type: ignore[union-attr]
                self._hear(scene, line.decode().strip())
            status = await process.wait()
        finally:
            with suppress(ProcessLookupError):
                process.terminate()
            await process.wait()
            if scene.source.is_relative_to(self.home):
                shutil.rmtree(scene.source.parent)
        if status < 0:
            self._hear(scene, f"signal {-status} ended the encode: is there memory for it?")
        if status == 0:
            heard, scene.lines = scene.lines, open_package(scene.package).manifest.decisions
            for line in [*(line for line in scene.lines if line not in heard), "encoded"]:
                self._say(f"{scene.package.name}: {line}")
        scene.status = status

    def _hear(self, scene: Scene, line: str) -> None:
        scene.lines = [line.removeprefix("airgs-encode: ").replace(f"{scene.source.parent}{os.sep}", "")]
        if found := _HOW_FAR.fullmatch(line):
            scene.share = int(found[1]) / 100
        else:
            self._say(f"{scene.package.name}: {scene.lines[0]}")

    def as_html(self) -> str:
        words = "Drop splats here (.ply, .spz, .sog, .splat, …), or <u>choose files</u>"
        zone = f'<label>{words}<input type="file" multiple data-most="{MOST_BYTES}"></label>\n<output></output>\n'
        said = f"{zone * self.dropping}<div>{''.join(scene.as_html() for scene in self._scenes)}</div>"
        return f'<section>{said}</section>\n<script type="module" src="/{LIST_SCRIPT}"></script>\n'
