"""A folder of .ply frames that somebody is still writing: the frames that are whole, as a sequence."""

from __future__ import annotations

import itertools
from fractions import Fraction
from pathlib import Path

from airgs_codec.errors import SceneError
from airgs_codec.scene.formats.form import FrameHeader
from airgs_codec.scene.formats.ply import is_whole, read_ply, read_ply_header
from airgs_codec.scene.formats.table import natural_key
from airgs_codec.scene.sequence import GaussianSequence, sequence_of
from airgs_codec.scene.sequence_json import SETTINGS_NAME


class GrowingFolder:
    """Looks at a folder again and again; a frame is taken once it is whole and all before it are."""

    def __init__(
        self, folder: str | Path, *, views: str | Path | None = None, fps: Fraction | float | None = None
    ) -> None:
        """The arguments are those of `open_sequence`; the folder need not be there yet."""
        self._folder = Path(folder)
        self._views, self._fps = views, fps
        self._frames: list[tuple[Path, FrameHeader]] = []
        self._sequence: GaussianSequence | None = None
        self._read_at = 0  # when the sequence.json of that was written

    def look(self) -> GaussianSequence | None:
        """The frames that are whole by now, as `open_sequence` would give them; None before the first.

        Raises SceneError as `open_sequence` does, and for a frame whose name comes before that of one that was taken.
        """
        fresh = [(path, read_ply_header(path)) for path in itertools.takewhile(is_whole, self._waiting())]
        written = self._settings_time()
        if fresh or (self._frames and written != self._read_at):
            self._frames += fresh
            self._read_at = written
            self._sequence = sequence_of(self._folder, self._frames, views=self._views, fps=self._fps)
        return self._sequence

    def check_finished(self) -> None:
        """Nobody writes any more. Raises SceneError where a file was left that is not whole, or there is no frame."""
        for path in self._waiting():
            read_ply(path)
        if self._sequence is None:
            raise SceneError(f"{self._folder}: expected at least one .ply frame, got none")

    def _waiting(self) -> list[Path]:
        """Files behind the frames that were taken, in order."""
        taken = {path for path, _ in self._frames}
        found = sorted((path for path in self._folder.glob("*.ply") if path not in taken), key=natural_key)
        if found and self._frames and natural_key(found[0]) < natural_key(self._frames[-1][0]):
            last = self._frames[-1][0].name
            raise SceneError(f"{found[0]}: expected frames to come in the order of their names, got it after {last}")
        return found

    def _settings_time(self) -> int:
        """Return when sequence.json was last written; 0 where it is not there."""
        path = self._folder / SETTINGS_NAME
        return path.stat().st_mtime_ns if path.is_file() else 0
