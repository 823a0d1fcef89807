"""The page that plays packages: its files, its address, and what it may load.

The player is built from web/ into the folder `page/` (`make page`), which is a part of the installed package.
"""

from __future__ import annotations

import base64
import hashlib
import re
from pathlib import Path
from urllib.parse import quote

from airgs_codec.errors import ConfigError
from airgs_codec.package.layout import JSON_NAME, MPD_NAME

PAGE = Path(__file__).parent / "page"
PLAYER_PAGE, PLAYER_SCRIPT = "player.html", "airgs-player.js"
# the first loads the others, from beside it
PLAYER_SCRIPTS = (PLAYER_SCRIPT, "airgs-vr.js", "airgs-more.js", "airgs-sound.js")
MODULES = ("airgs.js", "airgs-frames.js")  # for pages of others
PAGE_TYPES = {PLAYER_PAGE: "text/html"} | dict.fromkeys((*PLAYER_SCRIPTS, *MODULES), "text/javascript")
NOT_BUILT = "the player is not built: run make page, which needs Node 20 and npm"
_POLICY = {  # what a page may load, of each kind; nothing of any other
    "default-src": "'none'",
    "script-src": "'self'",
    "worker-src": "blob:",  # the player's workers are parts of its script
    "connect-src": "*",  # a package may lie anywhere
    "img-src": "* data: blob:",  # and so may a poster
    "style-src": "'unsafe-inline'",  # in the shadow of <airgs-player>
    "base-uri": "'none'",
    "form-action": "'none'",
}
_INLINE = re.compile(r"<script\b(?![^>]*\bsrc\s*=)[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)


def content_policy(page: str) -> str:
    """The Content-Security-Policy of an HTML page: what the player needs, and the scripts that stand in the page."""
    digests = [hashlib.sha256(script.encode()).digest() for script in _INLINE.findall(page)]
    scripts = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
    policy = _POLICY | {"script-src": " ".join([_POLICY["script-src"], *scripts])}
    return "; ".join(f"{name} {values}" for name, values in policy.items())


def player_address(name: str) -> str:
    """The address, from the root, that plays the package `name` of the same server."""
    return f"/{PLAYER_PAGE}?src={quote(f'{quote(name)}/', safe='/')}"


def is_built() -> bool:
    """Return whether the page is there; only a clone of the repository in which it was deleted has none."""
    return all((PAGE / name).is_file() for name in PAGE_TYPES)


def read_scripts() -> dict[str, bytes]:
    """The scripts of the player by their names. Raises ConfigError where it is not built."""
    if not is_built():
        raise ConfigError(f"{PAGE}: {NOT_BUILT}")
    return {name: (PAGE / name).read_bytes() for name in PLAYER_SCRIPTS}


def addresses(name: str) -> dict[str, str]:
    """Return where a package is, from the root of the server: its name, what plays it, and its tables."""
    tables, mpd = (f"/{quote(name)}/{path}" for path in (JSON_NAME, MPD_NAME))
    return {"name": name, "play": player_address(name), "tables": tables, "mpd": mpd}
