"""A Gaussian sequence: a folder of frames or one file, optional sequence.json, cameras and usage.npz."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from airgs_codec._arguments import argument, described, frame_argument, path_argument
from airgs_codec.errors import FrameError, SceneError
from airgs_codec.places.place import Copied, is_address
from airgs_codec.progress import Progress, as_reporter, silent
from airgs_codec.scene import beside
from airgs_codec.scene.beside import DEFAULT_FPS, SETTINGS_NAME, Usage
from airgs_codec.scene.camera import BLACK, Background, Camera, cameras_from
from airgs_codec.scene.cameras import CAMERA_NAMES, find_cameras, locate_cameras, read_posed
from airgs_codec.scene.cameras.forms import distinct, lens_notes
from airgs_codec.scene.files import require
from airgs_codec.scene.formats import table
from airgs_codec.scene.formats.clips import clip_of
from airgs_codec.scene.formats.form import Axes, Bake, Clip, FrameFormat, FrameHeader
from airgs_codec.scene.formats.ply import is_whole, read_ply, read_ply_header
from airgs_codec.scene.frames import (
    ZERO,
    HeldFrames,
    LazyFrames,
    Origin,
    Repaired,
    choose_origin,
    narrowed,
    origin_notes,
    place_rows,
    repair,
)
from airgs_codec.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from airgs_codec.media.movie import SoundTrack  # and PyAV with it

COMPANIONS = (beside.ATTRIBUTION_NAME, *CAMERA_NAMES)  # what is copied with one file that is opened by its own address
IN_MEMORY = Path("frames in memory")  # in place of a file
HELD_BYTES = 1 << 29  # of the frames of a group: more are read again and again, not held in memory


@dataclass(frozen=True, slots=True)
class GaussianSequence:
    """A sequence as `open_sequence` or `from_arrays` gives it: frames in display order, read when they are asked for.

    `len(s)`, `s[0]`, `s[-1]` and `for frame in s` are as of a list; a slice gives frames that are read when they are
    asked for. `s.read(0)` is the same frame as `s[0]`. It can be pickled.
    """

    folder: Path
    paths: tuple[Path, ...]  # of the frames
    headers: tuple[FrameHeader, ...]  # of the frames
    fps: Fraction  # frames a second
    keyframes: tuple[int, ...] | None  # first frames of groups, where sequence.json names them
    cameras: tuple[Camera, ...]  # empty where none are given
    max_sh_degree: int = 3  # SH bands above it are not read
    cameras_path: Path | None = None  # the file or folder that the cameras are from
    background: Background = BLACK  # what its cameras see behind it
    notes: tuple[str, ...] = ()  # what sequence.json says of it to people
    alone: bool = False  # one file, opened by its own name
    orders: Mapping[int, NDArray[np.int32]] = field(default_factory=dict, compare=False)  # by frame, see `place_rows`
    breaks: tuple[int, ...] = ()  # frames whose rows are not those of the frame before, though they are as many
    clip: Clip | None = None  # the file that all frames are in, if it is one; every path is its
    copied: Copied | None = field(default=None, compare=False)  # from an address; paths are those of the copy
    held: HeldFrames | None = field(default=None, compare=False)  # frames that need not be read again
    origin: Origin = ZERO  # in the world: positions of frames and cameras are from it
    stored_at: Origin = ZERO  # the origin that positions in the files are from
    credit: str | None = None  # who made the scene; None: what ATTRIBUTION.txt in its folder says
    sound_track: SoundTrack | None = None  # as long as the sequence

    @staticmethod
    def from_arrays(
        frames: Mapping[str, Any] | Iterable[Gaussians | Mapping[str, Any]],
        *,
        fps: Fraction | float = DEFAULT_FPS,
        cameras: Iterable[Camera] = (),
    ) -> GaussianSequence:
        """Return a sequence of frames in memory: Gaussians, or mappings of their arrays by name, of numpy or torch.

        A list stays in memory, without a copy of float32; what an iterator gives, and what other processes need, is
        written to a temporary folder that lasts as long. One mapping whose arrays have time as their first axis,
        (T, N, 3) and so on, is all frames. `sh_rest` may be left out. The background is that of the first camera.

        Raises SceneError, which names frame and attribute, for another shape than `Gaussians` has, what is not finite,
        a frame without rows, no frame, and SH degrees that differ.
        """
        views = tuple(argument("cameras", camera, Camera, "cameras") for camera in cameras)
        clip = clip_of(frames, fps)
        paths, behind = (IN_MEMORY,) * len(clip.headers), views[0].background if views else BLACK
        found = GaussianSequence(IN_MEMORY, paths, clip.headers, clip.fps, None, views, alone=True, clip=clip)
        return _from_own_origin(replace(found, background=behind))

    @property
    def sh_degree(self) -> int:
        return min(self.headers[0].sh_degree, self.max_sh_degree)

    @property
    def axes(self) -> Axes | None:
        """Return the direction of up, where the specification of the frames' format says it."""
        return None if self.clip else self.format.axes

    @property
    def format(self) -> FrameFormat:
        """Return the format of the frames, where they are no clip. Raises SceneError."""
        return table.format_of(self.paths[0])

    @property
    def attribution(self) -> str:
        """Return the maker of the scene: `credit`, else the text of ATTRIBUTION.txt or empty. Raises SceneError."""
        if self.credit is not None:
            return self.credit
        with _naming(self.copied):
            return beside.read_attribution(self.folder)

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, place: int) -> Gaussians: ...

    @overload
    def __getitem__(self, place: slice) -> LazyFrames: ...

    def __getitem__(self, place: int | slice) -> Gaussians | LazyFrames:
        return LazyFrames(self.read, range(len(self)))[place]

    def __iter__(self) -> Iterator[Gaussians]:
        return map(self.read, range(len(self)))

    def __repr__(self) -> str:
        place = self.name_of(self.paths[0] if self.alone else self.folder)
        return f"Sequence({place}: {len(self)} frames at {float(self.fps):g} a second)"

    def name_of(self, path: Path) -> str:
        """Return a path for people: the address, where it was copied from one."""
        return self.copied.named(str(path)) if self.copied else str(path)

    def count(self, frame: int) -> int:
        return len(self.orders[frame]) if frame in self.orders else self.headers[frame].count

    def usage(self, start: int, stop: int) -> Usage | None:
        """Return what the trainer measured over all frames of a group [start, stop), None where rows were reordered."""
        path = self.folder / beside.USAGE_NAME
        if self.alone or any(frame in self.orders for frame in range(start, stop)) or not path.is_file():
            return None
        with _naming(self.copied):
            return beside.load_usage(path, start, stop, self.count(start))

    def read(self, frame: int) -> Gaussians:
        """Read one frame unrepaired, as its file has it but for `orders`.

        Raises FrameError for a number below 0 or past the end, SceneError when the file is broken.
        """
        frame = frame_argument(frame, len(self))
        g = self._read_file(frame) if self.held is None else self.held.get(frame, self._read_file)
        g = g.with_degree(self.sh_degree)
        return place_rows(g, self.orders[frame]) if frame in self.orders else g

    def close(self) -> None:
        if self.held is not None:
            self.held.clear()

    def _read_file(self, frame: int) -> Gaussians:
        with _naming(self.copied):
            return narrowed(self._stored(frame), np.subtract(self.origin, self.stored_at), self.paths[frame])

    def _stored(self, frame: int) -> Gaussians:
        path = self.paths[frame]
        return self.clip.read(path, frame) if self.clip else table.read_frame(path)

    def at_origin(self, origin: Origin) -> GaussianSequence:
        """Return the sequence with positions of frames and cameras from another origin in the world."""
        if origin == self.origin:
            return self
        cameras = cameras_from(np.subtract(origin, self.origin), self.cameras)
        return replace(self, origin=origin, cameras=cameras, held=None)

    def load(self, wanted: Iterable[int]) -> Repaired:
        """Read frames of one group and repair them.

        Frames that take more than HELD_BYTES together are read once to find what must be repaired, and again whenever
        they are asked for. Raises SceneError as `repair` does, and for a broken file.
        """
        if not isinstance(wanted, Iterable):
            raise FrameError(f"frames: expected numbers of frames, got {described(wanted)}")
        numbers = [frame_argument(number, len(self)) for number in wanted]
        if not numbers:
            raise FrameError("frames: expected at least one, got none")
        span = f"frame {numbers[0]}" if len(numbers) == 1 else f"frames {numbers[0]}-{numbers[-1]}"
        where = f"{(self.paths[0] if self.alone else self.folder).name} {span}"
        held = sum(replace(self.headers[n], sh_degree=self.sh_degree).bytes for n in numbers) <= HELD_BYTES
        stored = LazyFrames(self.read, numbers)
        done = repair(list(stored) if held else stored, where)
        return replace(done, frames=list(done.frames)) if held else done


def open_sequence(
    folder: str | Path,
    *,
    views: str | Path | None = None,
    fps: Fraction | float | None = None,
    bake_fps: Fraction | float | None = None,
    duration: Fraction | float | None = None,
    progress: Progress | type = silent,
) -> GaussianSequence:
    """Open a folder of frames, a file of one frame or a clip; rows are read only when they are asked for.

    All of an address, s3://, gs:// or az://, is copied to a temporary folder that lasts as long as the sequence;
    `progress` is called meanwhile. Frames are of one format in `scene.formats.table.FRAMES`, in natural order of their
    names (frame2 before frame10); of an INRIA model the newest iteration is taken. Their folder may have

    - sequence.json: `{"fps": number, "keyframes": [first frame of each group, ...], "background": [r, g, b]}`; without
      it 30 frames a second before black;
    - cameras, the first of transforms.json, INRIA's cameras.json, COLMAP's sparse/ and Panoptic's train_meta.json; they
      may also be in the INRIA model that has the frames in its point_cloud/;
    - usage.npz: how much each Gaussian contributes to the training views, as the trainer measured it.

    For a file that is opened by its own name only cameras are looked for. `views` (another file or folder of cameras)
    and `fps` (frames a second, above 0 and at most 1000) go before what the folder says.

    A clip is a file of a format in `scene.formats.table.CLIPS`; `clip.note` says how it became frames. Moving Gaussians
    are baked at `bake_fps` frames a second, played at `fps` (default: the same); `duration` (seconds) is the length of
    a clip whose file states none. Its own cameras go before those in its folder, where they are of the scene.

    Raises SceneError for no frames, a broken frame, one without rows or of another SH degree, another malformed file,
    and a `bake_fps` of frames; ConfigError for a wrong address, TransportError for a store that does not answer.
    """
    folder = path_argument("folder", folder)
    rate = None if bake_fps is None else beside.frame_rate(str(folder), bake_fps)
    bake = Bake(rate, None if duration is None else Fraction(str(duration)))
    copied = Copied(str(folder), COMPANIONS, as_reporter(progress)) if is_address(folder) else None
    with _naming(copied):
        return replace(_open(copied.path if copied else Path(folder), bake, views, fps), copied=copied)


@contextmanager
def _naming(copied: Copied | None) -> Iterator[None]:
    """Name files by their addresses in a SceneError of the block, not by the paths of copies."""
    try:
        yield
    except SceneError as error:
        if copied is None:
            raise
        raise SceneError(copied.named(str(error))) from error


def _open(place: Path, bake: Bake, views: str | Path | None, fps: Fraction | float | None) -> GaussianSequence:
    folder, paths, alone = table.find_frames(place)
    path = paths[0]
    if len(paths) == 1 and (form := table.clip_format(path)):
        clip = form.open(path, bake)
        if views is None and path.suffix.lower() == ".splatv":
            try:
                read_posed(path)
                views = path
            except SceneError as error:  # its own are not of the scene
                clip = replace(clip, note=f"{clip.note}; no cameras from it ({str(error).removeprefix(f'{path}: ')})")
        headed = [(path, header) for header in clip.headers]
        rate = clip.fps if fps is None else fps
        return sequence_of(folder, headed, views=views, fps=rate, alone=True, clip=clip)
    require(bake == Bake(), place, f"expected a clip to bake ({', '.join(table.CLIP_SUFFIXES)}), got frames")
    headed = [(path, table.read_frame_header(path)) for path in paths]
    return sequence_of(folder, headed, views=views, fps=fps, alone=alone)


def sequence_of(
    folder: Path,
    frames: Sequence[tuple[Path, FrameHeader]],
    *,
    views: str | Path | None = None,
    fps: Fraction | float | None = None,
    alone: bool = False,
    clip: Clip | None = None,
    origin: Origin | None = None,
) -> GaussianSequence:
    """Return the sequence of frames with these headers, at least one, and other files of their folder.

    `alone`: it is one file. `origin`: by default the one that `choose_origin` gives for the first frame.
    """
    first, degree = frames[0][0], frames[0][1].sh_degree
    for path, header in frames:
        require(header.count, path, "expected at least one Gaussian, got none")
        if header.sh_degree != degree:
            raise SceneError(f"{path}: expected SH degree {degree} as in {first.name}, got {header.sh_degree}")
    paths, headers = zip(*frames, strict=True)
    own = beside.Settings() if alone else beside.read_settings(folder, len(frames))
    cameras_path = locate_cameras(Path(views)) if views else find_cameras(folder)
    posed = read_posed(cameras_path) if cameras_path else []
    cameras = (replace(camera, background=own.background) for camera in distinct(posed))
    gaps = [] if alone else table.gap_notes(paths)
    rate, views_of = own.fps if fps is None else beside.frame_rate(str(folder), fps), cameras_from(own.origin, cameras)
    found = GaussianSequence(folder, paths, headers, rate, own.keyframes, views_of, alone=alone, clip=clip)
    found = replace(found, cameras_path=cameras_path, notes=(*own.notes, *gaps, *lens_notes(posed)))
    found = replace(found, background=own.background, origin=own.origin, stored_at=own.origin)
    return _from_own_origin(found) if origin is None else found.at_origin(origin)


def _from_own_origin(sequence: GaussianSequence) -> GaussianSequence:
    """Return the sequence from the origin that its first frame needs, with a note on that."""
    first = sequence._stored(0)
    if (shift := choose_origin(first)) == ZERO:
        return sequence
    x, y, z = np.add(sequence.stored_at, shift).tolist()
    found = sequence.at_origin((x, y, z))
    return replace(found, notes=(*found.notes, *origin_notes(first, found.origin)))


class GrowingFolder:
    """A folder of .ply frames that is still being written; a frame is taken once it and all before it are whole."""

    def __init__(
        self, folder: str | Path, *, views: str | Path | None = None, fps: Fraction | float | None = None
    ) -> None:
        self._folder, self._views, self._fps = Path(folder), views, fps
        self._frames: list[tuple[Path, FrameHeader]] = []
        self._sequence: GaussianSequence | None = None
        self._read_at = 0  # when the sequence.json of that was written

    def look(self) -> GaussianSequence | None:
        """Return the frames that are whole by now, as `open_sequence` would give them; None before the first.

        Raises SceneError as `open_sequence` does, and for a frame whose name comes before that of one that was taken.
        """
        fresh = [(path, read_ply_header(path)) for path in itertools.takewhile(is_whole, self._waiting())]
        settings = self._folder / SETTINGS_NAME
        written = settings.stat().st_mtime_ns if settings.is_file() else 0
        if fresh or (self._frames and written != self._read_at):
            self._frames, self._read_at = self._frames + fresh, written
            origin = self._sequence.origin if self._sequence else None
            self._sequence = sequence_of(self._folder, self._frames, views=self._views, fps=self._fps, origin=origin)
        return self._sequence

    def check_finished(self) -> None:
        """Raise SceneError where a file is not whole, or no frame was written."""
        for path in self._waiting():
            read_ply(path)
        require(self._sequence, self._folder, "expected at least one .ply frame, got none")

    def _waiting(self) -> list[Path]:
        taken = {path for path, _ in self._frames}
        found = sorted((path for path in self._folder.glob("*.ply") if path not in taken), key=table.natural_key)
        if found and self._frames and table.natural_key(found[0]) < table.natural_key(self._frames[-1][0]):
            last = self._frames[-1][0].name
            raise SceneError(f"{found[0]}: expected frames to come in the order of their names, got it after {last}")
        return found
