"""AirGS itself as one of the methods: trained, encoded as `airgs-encode` does by default, and decoded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field

import numpy as np

from airgs_codec.decoder.decode import decode_frames
from airgs_codec.encoder.publish import encode
from airgs_codec.encoder.settings import EncodeSettings
from airgs_codec.package.manifest import Manifest
from airgs_codec.package.package import Package, open_package
from airgs_codec.progress import Progress
from airgs_codec.scene.sequence import open_sequence
from airgs_codec.trainer import train
from airgs_codec.trainer.data.multiview import MultiviewScene
from airgs_codec.trainer.settings import TrainSettings
from tools.lab.baselines.method import Footage, Shown

MODEL, PACKAGE = "model", "package"  # in the folder of the run


@dataclass(frozen=True, slots=True, eq=False)
class AirGS:
    """The trainer and the encoder of this project; a frame is what a viewer of the top rung sees."""

    scene: MultiviewScene  # the footage, whose pictures the trainer reads by itself
    training: TrainSettings = field(default_factory=TrainSettings)
    encoding: EncodeSettings = field(default_factory=EncodeSettings)
    name: str = "airgs"

    @property
    def settings(self) -> dict[str, object]:
        return {"training": self.training.table(), "encoding": asdict(self.encoding)}

    def frames(self, footage: Footage, done: int, progress: Progress) -> Iterator[Shown]:
        """The frames from number `done` on. Raises what `train` and `encode` do."""
        model = train(self.scene, footage.folder / MODEL, self.training, resume=True, progress=progress)
        encode(open_sequence(model.folder), footage.folder / PACKAGE, self.encoding, progress=progress)
        package = open_package(footage.folder / PACKAGE)
        sizes = fetched_bytes(package)
        for frame in decode_frames(package, done, footage.frames):
            record = model.record.frames[frame.number]
            kind = "frame" if record.kind == "frame" else "keyframe"
            yield Shown(kind, frame.gaussians, sizes[frame.number])


def fetched_bytes(package: Package) -> list[int]:
    """Bytes of each frame that a viewer of the top rung fetches: in all, what the rung and the tables take.

    Keyframes count at the first frame of their group, tables and what the frames of a segment share are spread evenly.
    """
    m = package.manifest
    shared = package.manifest_bytes + m.init.bytes
    sizes = np.full(m.frames, shared / m.frames)
    for index, segment in enumerate(m.segments):
        sizes[segment.start : segment.stop] += delta_bytes(m, index, 0)
    for group, spans in enumerate(m.groups):
        sizes[spans.start] += keyframe_bytes(m, group, 0)
    ends = np.round(np.cumsum(sizes)).astype(int)
    return [int(size) for size in np.diff(ends, prepend=0)]


def delta_bytes(m: Manifest, segment: int, level: int) -> np.ndarray:
    """(T,) bytes of the frames of a segment at a level; what they share is spread evenly."""
    entry = m.segments[segment]
    frames = entry.stop - entry.start
    own = np.array(entry.levels[level].frame_bytes or [0] * frames, float)
    return own + (m.bytes_of(m.delta_files(segment, level)) - own.sum()) / frames


def keyframe_bytes(m: Manifest, group: int, level: int) -> int:
    """Bytes of the keyframes of a group in the finest quality, of the tiers that viewers of a level fetch."""
    return m.bytes_of([path for tier in range(m.levels[level].tiers) for path in m.keyframe_files(group, tier, 0)])
