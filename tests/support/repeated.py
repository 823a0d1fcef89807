"""A package that shows the groups of another one over and over, without encoding anything."""

from dataclasses import replace
from pathlib import Path

from airgs_codec.media.mp4 import init_segment
from tests import faces
from tests.faces import INIT_NAME, Folder, Group, Groups, Package, largest_picture, write_file


def write_repeated(package: Package, folder: Path, times: int, fps: int) -> Path:
    """A package with the groups of another one, so often and at another speed."""
    m, files = package.manifest, Folder(folder)
    groups: list[Group] = []
    segments = 0
    for n in range(times * len(m.groups)):
        repeats, source = divmod(n, len(m.groups))
        group, shift = m.groups[source], repeats * m.frames
        moved = [replace(s, start=s.start + shift, stop=s.stop + shift) for s in group.segments]
        groups.append(replace(group, start=group.start + shift, stop=group.stop + shift, segments=moved))
        for tier in range(m.tiers):
            files.write(
                faces.keyframe_sidecar_path(tier, n + 1), package.read(faces.keyframe_sidecar_path(tier, source + 1))
            )
            for quality in range(len(m.qualities)):
                path = faces.keyframe_media_path(tier, quality, source + 1)
                files.write(faces.keyframe_media_path(tier, quality, n + 1), package.read(path))
        for s in m.segments_of(source):
            segments += 1
            for level in range(len(m.levels)):
                for path in m.delta_files(s, level):
                    files.write(faces.delta_media_path(level, segments), package.read(path))
    init = write_file(files, INIT_NAME, init_segment(1000 * fps, *largest_picture(m.groups)))
    m = replace(
        m, frame_rate=[fps, 1], timescale=1000 * fps, frames=groups[-1].stop, groups=Groups.of(groups), init=init
    )
    faces.write_tables(files, m)
    return folder
