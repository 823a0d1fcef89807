"""What the frames of a run are fitted with: the scene, its pictures, and what rests before its cameras. N Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch

from airgs_codec.analysis.sensitivity import UsageSums
from airgs_codec.errors import SceneError
from airgs_codec.progress import Progress, silent
from airgs_codec.render.backend import Renderer
from airgs_codec.scene.beside import Usage
from airgs_codec.scene.gaussians import Gaussians
from airgs_codec.trainer.data.multiview import MultiviewScene, with_frames
from airgs_codec.trainer.data.pictures import Exposure, Pictures, View, pictures_for
from airgs_codec.trainer.data.plates import Masks, Plate, Plates, find_moving, settle
from airgs_codec.trainer.fit.trainer import FrameViews, Trainer, make_trainer
from airgs_codec.trainer.record import Span
from airgs_codec.trainer.settings import TrainSettings

FOLLOWED = 0.6  # what an iteration of a frame that follows another takes, in those of a first frame
CAPACITY = 1.5  # times as many Gaussians as the first frame has may there ever be, unless settings say more


@dataclass(slots=True)
class RunProgress:
    """Progress of a whole run, in iterations of a first frame: its stage is `training`, and after a colon the frame.

    Which frames become keyframes is not known before; what they take more is added when they do.
    """

    progress: Progress
    first: float  # of the first frame
    later: float  # of every other one
    frames: int
    _more: float = field(init=False, default=0.0)  # that frames before have taken beyond what was planned

    def of(self, frame: int) -> Progress:
        """Progress of the fits of a frame, each of which is a stage; one frame at a time, ascending."""
        planned, cost = (self.later, FOLLOWED) if frame else (self.first, 1.0)
        begun = self.first + (frame - 1) * self.later if frame else 0.0
        before, now, more = 0.0, ("", 0.0), self._more

        def tell(stage: str, done: int, total: int) -> None:
            nonlocal before, now
            if stage != now[0]:
                before, now = before + now[1], (stage, cost * total)
            self._more = more + max(0.0, before + cost * total - planned)
            at, whole = begun + more + before + cost * done, self.first + (self.frames - 1) * self.later + self._more
            self.progress(f"training: frame {frame} of {self.frames} ({stage})", round(at), round(whole))

        return tell


@dataclass(frozen=True, slots=True, eq=False)
class First:
    """The first frame of a run, which all chunks start from."""

    gaussians: Gaussians
    exposure: Exposure = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Capture:
    """A scene with all that its frames are fitted with."""

    scene: MultiviewScene
    settings: TrainSettings
    device: str  # cpu or cuda
    pictures: Pictures
    plates: Plates = field(default_factory=dict)  # of every training camera; none: nothing is known to rest
    _moving: dict[int, Masks] = field(init=False, default_factory=dict)  # of the last frame that was a target

    @staticmethod
    def of(scene: MultiviewScene, settings: TrainSettings, device: str) -> Capture:
        """A scene whose plates and exposure are not known. `device`: cpu or cuda."""
        return Capture(scene, settings, device, pictures_for(scene, settings))

    @cached_property
    def trainer(self) -> Trainer:
        """Open what all fits share when a fit asks for it: who only writes what others fitted needs no device.

        Raises ConfigError where the device is not there.
        """
        if self.device == "cpu":
            torch.set_num_threads(1)  # the kernels have their own threads, and two pools fight over the cores
        return make_trainer(self.settings, self.pictures.train(0), self.scene.points, self.device)

    def with_exposure(self, exposure: Exposure) -> Capture:
        """The same, its pictures as the average camera would have exposed them."""
        return replace(self, pictures=self.pictures.with_exposure(exposure)) if exposure else self

    def with_first(self, first: First) -> Capture:
        """The same whose first frame is known."""
        s = self.settings
        capacity = s.capacity or max(s.budget or 1, round(CAPACITY * len(first.gaussians)))
        return replace(self.with_exposure(first.exposure), settings=replace(s, capacity=capacity))

    def with_plates(self, plates: Iterable[Plate]) -> Capture:
        """The same that knows what rests; `plates`: of every training camera, or none at all."""
        names, found = [camera.name for camera in self.scene.cameras if not camera.held_out], list(plates)
        return replace(self, plates=dict(zip(names, found, strict=True)) if found else {})

    def told(self, progress: Progress) -> RunProgress:
        cameras = [camera for camera in self.scene.cameras if not camera.held_out]
        first, later = self.settings.iterations_from_scratch(len(cameras)), FOLLOWED * self.settings.frame_iterations
        return RunProgress(progress, first, later, len(self.scene))

    def within(self, frames: Iterable[int]) -> Capture:
        """The same for frames of a chunk: what they share with later ones is not looked for, where they are given."""
        if self.scene.given is None:
            return self
        return replace(self, scene=with_frames(self.scene, {0, *frames}))

    def views(self, frame: int) -> list[View]:
        """The training views of a frame. Raises SceneError when there are none, or a picture cannot be read."""
        views = self.pictures.train(frame)
        if not views:
            raise SceneError(f"{self.scene.path}: expected training views of frame {frame}, got none")
        return settle(views, self.plates, self.pictures.exposure)[0] if self.plates else views

    def first(self) -> FrameViews:
        """The first frame of the run as it is fitted: cameras that saw it before its time saw it after that, too."""
        target = FrameViews(0, self.views(0))
        return replace(target, later=self._behind(target).views)

    def key(self, target: FrameViews) -> FrameViews:
        """The same frame as it is fitted where a group begins: what was seen before its time may not show it at all.

        Cameras that were early show what they saw next, where that is known.
        """
        kept, behind = [i for i, view in enumerate(target.views) if view.after >= 0], self._behind(target)
        if len(kept) == len(target.views) or not (kept or behind.views):
            return target
        views = [*(target.views[i] for i in kept), *behind.views]
        if target.moving is None or behind.moving is None:
            return replace(target, views=views, moving=None)
        return replace(target, views=views, moving=Masks([*(target.moving[i] for i in kept), *behind.moving]))

    def _behind(self, target: FrameViews) -> FrameViews:
        """What cameras that were early saw next; no views where the frame behind a frame is not known."""
        early, frame = [i for i, view in enumerate(target.views) if view.after < 0], target.frame + 1
        if not early or not any(self.scene.frames[frame : frame + 1]):
            return FrameViews(target.frame, [], Masks([]))
        seen, moving = self.pictures.train(frame), None
        places = _places(seen)
        pairs = [(i, places[name]) for i in early if (name := target.views[i].camera.name) in places]
        if self.plates:
            seen, now = settle(seen, self.plates, self.pictures.exposure)
            moving = Masks((target.moving[i] | now[j]) if target.moving else now[j] for i, j in pairs)
        return FrameViews(target.frame, [replace(seen[j], after=seen[j].after + 1) for _, j in pairs], moving)

    def target(self, frame: int, start: int) -> FrameViews:
        """A frame as it is fitted from the Gaussians of the frame `start`. Raises what `views` does."""
        if not self.plates:
            return FrameViews(frame, self.views(frame))
        exposure = self.pictures.exposure
        before, seen = self._moving.pop(start, None), self.pictures.train(start)
        if before is None:  # pictures of a frame that is past may be out of memory
            before = find_moving(seen, self.plates, exposure)
        views, now = settle(self.pictures.train(frame), self.plates, exposure)
        self._moving.clear()
        self._moving[frame] = now
        places = _places(seen)  # a camera without a picture of the frame before tells what moves now alone
        pairs = ((mask, places.get(view.camera.name)) for mask, view in zip(now, views, strict=True))
        return FrameViews(frame, views, Masks(mask if i is None else mask | before[i] for mask, i in pairs))

    def given(self, frame: int) -> Gaussians:
        """The Gaussians that the pictures of a frame are drawn from, repaired. Raises SceneError for a broken file."""
        assert self.scene.given is not None
        return self.scene.given.load([frame]).frames[0]

    def usage(self, read: Callable[[int], Gaussians], span: Span, progress: Progress = silent) -> Usage:
        """The usage of a group over its frames [start, stop), which `read` gives, and all its training views."""
        return group_usage(read, self.pictures, self.trainer.renderer, span, progress)


def _places(views: Sequence[View]) -> dict[str, int]:
    return {view.camera.name: place for place, view in enumerate(views)}


def group_usage(
    read: Callable[[int], Gaussians],
    pictures: Pictures,
    renderer: Renderer,
    span: tuple[int, int],
    progress: Progress = silent,
) -> Usage:
    """Usage over all frames [start, stop) of a group, which `read` gives, and all its training views."""
    start, stop = span
    sums = UsageSums(len(read(start)))
    for done, frame in enumerate(range(start, stop), 1):
        loaded = renderer.load(read(frame))
        for view in pictures.train(frame):
            sums.add(loaded.contribution(view.camera))
        progress(f"usage of frames {start} to {stop - 1}", done, stop - start)
    return sums.usage()
