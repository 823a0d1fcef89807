"""A package that gains groups while somebody reads it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from tests import faces
from tests.faces import Folder, open_package
from tests.support.paths import VALID

PAGED = VALID / "paged"  # 65 groups of a frame; a page holds 64


class Growing:
    """A package with so many of its groups, published one step after another."""

    def __init__(self, folder: Path, *counts: int, whole: Path = PAGED) -> None:
        shutil.copytree(whole, folder)
        shutil.rmtree(folder / "index", ignore_errors=True)
        self.folder, self.waiting, self.whole = folder, list(counts), open_package(whole).manifest
        self.count = 0  # of the groups that are there
        self.publish()

    def publish(self) -> None:
        count = self.waiting.pop(0) if self.waiting else None
        if count is None:
            return
        self.count = count or self.count
        groups = self.whole.groups[: self.count]
        _, pages = faces.build_index(groups, [faces.pack_group(group) for group in groups])
        for path, page in pages.items():
            Folder(self.folder).write(path, faces.pack_json(page))
        rungs = [[replace(rung, pictures=self.count) for rung in levels] for levels in self.whole.rungs]
        own = faces.Groups.of(groups)
        m = replace(self.whole, groups=own, live=count > 0, frames=groups[-1].stop, rungs=rungs)
        now = datetime.now(UTC)
        faces.write_root(Folder(self.folder), m, faces.LiveClock(now, now))

    def received(self, path: str, data: bytes) -> None:
        if path == faces.JSON_NAME:
            self.publish()
