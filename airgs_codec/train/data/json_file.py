"""JSON files of scenes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from airgs_codec.errors import SceneError


def read_object(path: Path) -> dict[str, Any]:
    """The object in a JSON file. Raises SceneError when there is none."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: expected JSON: {error}") from error
    if not isinstance(data, dict):
        raise SceneError(f"{path}: expected a JSON object, got {type(data).__name__}")
    return data
