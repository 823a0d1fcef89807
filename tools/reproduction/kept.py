"""Parts of a reproduction that are finished stay finished: their values lie in a folder as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airgs_codec._files import to_json, write_json


@dataclass(frozen=True, slots=True)
class KeptParts:
    """A folder of finished parts."""

    folder: Path

    def get(self, name: str, key: dict[str, Any], make: Callable[[], Any]) -> Any:
        """The value of a part, made unless it is kept for the same `key`; key and value are plain JSON."""
        path = self.folder / f"{name}.json"
        wanted = json.loads(to_json(key))
        if path.exists():
            kept = json.loads(path.read_text())
            if kept["key"] == wanted:
                return kept["value"]
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(path, {"key": wanted, "value": make()})
        return json.loads(path.read_text())["value"]
