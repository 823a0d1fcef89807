"""A picture of the player in a browser: serves a package, opens it in headless Chromium and writes what is to be seen.

    python -m tools.screenshot PACKAGE -o FILE.png

Needs chromium, Node 20 and the packages of web/ (`make test` installs them); says so and does nothing where one of them
is not there. Exit status 2 where nothing is played within a minute.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

from airgs_codec.serve.pages import is_built, player_address
from tools.lab.serving import airgs_serve

REPOSITORY = Path(__file__).parent.parent
SCRIPT = REPOSITORY / "web" / "scripts" / "screenshot.mjs"


def missing() -> list[str]:
    found = {
        "chromium": shutil.which("chromium") is not None,
        "node": shutil.which("node") is not None,
        "the packages of web/ (npm ci --prefix web)": (REPOSITORY / "web/node_modules/playwright-core").is_dir(),
        "the player (make page)": is_built(),
    }
    return [what for what, there in found.items() if not there]


def take(package: Path, picture: Path) -> int:
    """Serve a package and write the picture; gives the exit status."""
    with airgs_serve(package) as (_, address):
        shot = ["node", str(SCRIPT), address + player_address(package.resolve().name), str(picture)]
        environment = os.environ | {"CHROMIUM": shutil.which("chromium") or ""}
        return subprocess.run(shot, env=environment, check=False).returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, metavar="PACKAGE", help="folder with airgs.json")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.png")
    args = parser.parse_args()
    if lacking := missing():
        print(f"no {args.output}: this machine lacks {', '.join(lacking)}")
        return 0
    return take(args.package, args.output)


if __name__ == "__main__":
    sys.exit(main())
