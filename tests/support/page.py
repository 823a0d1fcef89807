"""A page in the place of the player that web/ builds, so that tests of servers and sites need no Node."""

from __future__ import annotations

from pathlib import Path

import pytest

from airgs_codec.serve import files, pages

INLINE = "document.title = 'ready';"
FILES = {
    "player.html": f'<!doctype html><script type="module" src="airgs-player.js"></script><script>{INLINE}</script>',
    "airgs-player.js": "customElements.define('airgs-player', class extends HTMLElement {});\n",
    "airgs-vr.js": "export const enter = () => {};\n",
    "airgs-more.js": "export const readCameraPath = () => {};\n",
    "airgs-sound.js": "export class Sound {}\n",
    "airgs.js": "export const open = () => {};\n",
    "airgs-frames.js": "export const openFrames = () => {};\n",
}


def put_page(folder: Path, patch: pytest.MonkeyPatch) -> Path:
    """Write a page into `folder`, and let the server and the export take it for the player."""
    folder.mkdir(exist_ok=True)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    for module in (files, pages):
        patch.setattr(module, "PAGE", folder)
    return folder
