"""Which packages are served: folders named one by one, and those in folders that hold packages, as they appear."""

from __future__ import annotations

import os
from pathlib import Path

from airgs_codec.errors import ConfigError
from airgs_codec.package.paths import JSON_NAME


class Shelves:
    """The folders of packages by their names."""

    def __init__(self, folders: list[Path]) -> None:
        """`folders`: packages, and folders that hold packages.

        Raises ConfigError for a folder of neither kind and for two packages of one name.
        """
        self._named: dict[str, Path] = {}
        self._holders: list[Path] = []
        self._known: dict[str, Path] = {}
        for folder in folders:
            self._add(folder)

    def _add(self, folder: Path) -> None:
        own = _is_package(folder)
        found = {folder.resolve().name: folder.absolute()} if own else _packages_in(folder)
        if not found:
            kinds = f"a package with {JSON_NAME} or a folder with packages"
            raise ConfigError(f"{folder}: expected {kinds}, got nothing of that kind")
        for name in sorted(found.keys() & self._known.keys()):
            raise ConfigError(f"{found[name]}: expected packages of different names, got {name} twice")
        self._known |= found
        if own:
            self._named |= found
        else:
            self._holders.append(folder.absolute())

    def packages(self) -> dict[str, Path]:
        """Those that are there now. Where a name has come up twice, the folder that was named first has it."""
        found: dict[str, Path] = {}
        for holder in reversed(self._holders):
            found |= _packages_in(holder)
        self._known = found | self._named
        return dict(self._known)

    def find(self, name: str) -> Path | None:
        """The folder of a package, None where there is no such package."""
        return self._known.get(name) or self.packages().get(name)


def _is_package(folder: Path) -> bool:
    return (folder / JSON_NAME).is_file()


def _packages_in(holder: Path) -> dict[str, Path]:
    """The packages in a folder: no links, nothing hidden, and no name that an address cannot have."""
    try:
        with os.scandir(holder) as entries:
            names = sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
    except OSError:
        return {}
    usable = (name for name in names if not name.startswith(".") and name.isprintable())
    return {name: holder.absolute() / name for name in usable if _is_package(holder / name)}
