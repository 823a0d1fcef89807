"""A small scene to train on, and settings that train it in seconds."""

from __future__ import annotations

from pathlib import Path

from tests.faces import TrainSettings
from tests.support.multiview_files import write_views
from tests.support.views import appeared, coloured_cloud, joined, moved, ring

SETTINGS = TrainSettings(
    budget=260,
    capacity=400,
    sh_degree=0,
    first_iterations=140,
    key_iterations=120,
    frame_iterations=25,
    max_growth=0.4,
    max_drop_db=3.0,
)
APPEARS = 3  # frame of `write_blobs`


def write_blobs(folder: Path) -> Path:
    """Five frames; a part moves, and at APPEARS something comes into empty space."""
    g = coloured_cloud(120)
    frames = []
    for t in range(5):
        now = moved(g, slice(0, 20), (0.02 * t, 0.0, 0.0))
        frames.append(joined(now, appeared()) if t >= APPEARS else now)
    write_views(folder, frames, ring(7, size=40, held_out=1), g.means)
    (folder / "ATTRIBUTION.txt").write_text("blobs by nobody\n")
    return folder
