"""Render-referenced PSNR and SSIM of decoded frames against original ones, pooled over views and frames.

python tools/compare_sequences.py ORIGINAL DECODED --views transforms.json [--frames 0,4,8]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from airgs_codec.media.color import delta_e
from airgs_codec.media.metrics import mse, psnr, ssim
from airgs_codec.render import read_cameras, render
from airgs_codec.scene.sequence import open_sequence


def main() -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("original", type=Path)
    parser.add_argument("decoded", type=Path)
    parser.add_argument("--views", type=Path, required=True)
    parser.add_argument("--split", default="test")
    parser.add_argument("--frames", help="comma-separated (default: all)")
    parser.add_argument("--delta-e", action="store_true", help="mean CIEDE2000 too (slow)")
    args = parser.parse_args()
    original, decoded = open_sequence(args.original), open_sequence(args.decoded)
    cameras = [camera for camera in read_cameras(args.views) if camera.split == args.split]
    frames = [int(f) for f in args.frames.split(",")] if args.frames else range(len(original))
    squared, similarity, colour = [], [], []
    for frame in frames:
        a, b = original.load([frame]).frames[0], decoded.read(frame)
        for camera in cameras:
            pictures = render(a, camera).rgb, render(b, camera).rgb
            squared.append(mse(*pictures))
            similarity.append(ssim(*pictures))
            if args.delta_e:
                colour.append(delta_e(*pictures))
    result = {"frames": list(frames), "views": len(cameras), "psnr": psnr(float(np.mean(squared)))}
    result |= {"ssim": float(np.mean(similarity))} | ({"delta_e": float(np.mean(colour))} if colour else {})
    print(json.dumps(result))


if __name__ == "__main__":
    main()
