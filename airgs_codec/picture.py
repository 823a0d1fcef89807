"""Reading and writing pictures. The only importer of cv2."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from airgs_codec.errors import SceneError


def to_bytes(rgb: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(H, W, 3) RGB of [0, 1] -> 8 bit; what lies outside is shown at the bound, as a screen does."""
    return np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8)


def write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    """Write an (H, W, 3) RGB picture."""
    _, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    path.write_bytes(data.tobytes())


def read_png(path: Path) -> NDArray[np.float32]:
    """(H, W, 3) RGB of [0, 1]. Raises SceneError when the file is not a picture."""
    data = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if picture is None:
        raise SceneError(f"{path}: expected a picture")
    return np.float32(1 / 255) * cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def label(rgb: NDArray[np.uint8], text: str, line: int = 0) -> NDArray[np.uint8]:
    """A copy of the (H, W, 3) picture with a line of white text on a dark band at the top."""
    out = rgb.copy()
    top = 18 * line
    out[top : top + 18] //= 3
    cv2.putText(out, text, (5, top + 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
    return out


def blur(picture: NDArray[np.float32], kernel: NDArray[np.float32]) -> NDArray[np.float32]:
    """Separable filter of an (H, W, 3) picture by a 1-D kernel; borders mirrored."""
    return cv2.sepFilter2D(picture, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101).astype(np.float32)
