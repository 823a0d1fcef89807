"""Cut the embedded demo scene out of a full sequence: fewer frames and the most used Gaussians, rows kept in place.

    python -m tests.makers.demo_scene SEQUENCE MULTIVIEW TRACE OUT

SEQUENCE: folder of .ply frames with a keyframe at 12; MULTIVIEW: its transforms.json and images; TRACE: a Raca CSV.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np

from tests.faces import open_sequence, read_cameras, write_ply
from tests.support.views import measure_usage

FIRST, KEYFRAME, LAST = 7, 12, 16  # frames of the full sequence, last included
COUNT = 5_000  # Gaussians of the first group; the second keeps the same rows and what was added


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("sequence", "multiview", "trace", "out"):
        parser.add_argument(name, type=Path)
    args = parser.parse_args()
    args.out.mkdir(parents=True)
    transforms = args.multiview / "transforms.json"
    sequence = open_sequence(args.sequence, views=transforms)
    training = [camera for camera in read_cameras(transforms) if camera.split == "train"]
    before, after = sequence.read(KEYFRAME - 1), sequence.read(KEYFRAME)
    old = len(before)
    peak_before = measure_usage([before], training).total
    peak_after = measure_usage([after], training).total
    kept = np.sort(np.argsort(-(peak_before + peak_after[:old]), kind="stable")[:COUNT])
    added = old + np.flatnonzero(peak_after[old:] > np.quantile(peak_after[old:], 0.4))
    for number, frame in enumerate(range(FIRST, LAST + 1)):
        rows = kept if frame < KEYFRAME else np.concatenate([kept, added])
        write_ply(args.out / f"{number:06d}.ply", sequence.read(frame).take(rows))
    data = json.loads(transforms.read_text())
    data["frames"] = [{**f, "file_path": ""} for f in data["frames"] if f["time_index"] == 0]
    (args.out / "transforms.json").write_text(json.dumps(data, indent=1) + "\n")
    settings = {"fps": data["fps"], "keyframes": [0, KEYFRAME - FIRST]}
    (args.out / "sequence.json").write_text(json.dumps(settings) + "\n")
    for frame in (FIRST, KEYFRAME):
        picture = args.multiview / "images" / "cam16" / f"{frame:04d}.png"
        shutil.copyfile(picture, args.out / f"cam16_frame{frame - FIRST:06d}.png")
    shutil.copyfile(args.trace, args.out / "trace.csv")


if __name__ == "__main__":
    main()
