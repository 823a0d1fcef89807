"""Cut the embedded multi-view pictures out of the full ones: six frames around the keyframe, small.

    python -m tests.makers.demo_views MULTIVIEW OUT

MULTIVIEW: folder with transforms.json, points3d.npy and 320 x 320 pictures; the points are of its first frame.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import cv2
import numpy as np

FIRST, LAST = 9, 14  # frames of the full scene, last included; a cake drops in at 12
SIZE = 128  # pixels
JPEG_QUALITY = 95


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("multiview", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    data = json.loads((args.multiview / "transforms.json").read_text())
    scale = SIZE / data["w"]
    data |= {"w": SIZE, "h": SIZE} | {key: data[key] * scale for key in ("fl_x", "fl_y", "cx", "cy")}
    kept = [f for f in data["frames"] if FIRST <= f["time_index"] <= LAST]
    for frame in kept:
        picture = cv2.imread(str(args.multiview / frame["file_path"]))
        if picture is None:
            raise SystemExit(f"{frame['file_path']}: expected a picture")
        frame["time_index"] -= FIRST
        frame["time"] = round(frame["time_index"] / data["fps"], 4)
        frame["file_path"] = f"images/{frame['camera']}/{frame['time_index']:04d}.jpg"
        small = cv2.resize(picture, (SIZE, SIZE), interpolation=cv2.INTER_AREA)
        path = args.out / frame["file_path"]
        path.parent.mkdir(parents=True, exist_ok=True)
        options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111]
        cv2.imwrite(str(path), small, options)
    compact = [{**f, "transform_matrix": np.round(f["transform_matrix"], 7).tolist()} for f in kept]
    lines = ",\n".join(json.dumps(f) for f in compact)
    head = json.dumps({key: value for key, value in data.items() if key != "frames"})[:-1]
    (args.out / "transforms.json").write_text(f'{head}, "frames": [\n{lines}\n]}}\n')
    shutil.copyfile(args.multiview / "points3d.npy", args.out / "points3d.npy")


if __name__ == "__main__":
    main()
