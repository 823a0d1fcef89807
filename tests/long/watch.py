"""Somebody leaves a player on: a package that plays on and on in every browser, whose memory is looked at.

python -m tests.long.watch [--minutes 30] [--package manifests/showcase/fox.airgs]

All browsers play at once, in small pictures, so that drawing in software leaves time to the rest. The player compares
the checksum of every picture that it decodes, and what it reports as a problem is counted here. Memory is the
proportional set size of a browser's processes. Exit status 1 where a problem was reported, nothing was shown in some
minute, or the median of the last third is more than GROWN times that of the middle third.
"""

import argparse
import json
import os
import sys
import threading
import time
from pathlib import Path
from statistics import median
from typing import Any

from airgs_codec.serve.pages import PAGE
from tests.support.browser import serve
from tests.support.browsers import BROWSERS, Browser
from tests.support.paths import REPOSITORY

GROWN = 1.1
EVERY_S = 10
WATCH = """<!doctype html><script type="module" src="/page/airgs-player.js"></script>
<airgs-player src="/package/" autoplay loop muted style="inline-size: 240px; aspect-ratio: 4 / 3"></airgs-player>
<script type="module">
const element = document.querySelector("airgs-player");
const problems = [];
element.addEventListener("problem", ({ detail }) => problems.push(detail.message));
for (;;) {
  await new Promise((resolve) => setTimeout(resolve, 1000 * EVERY));
  const { framesShown, framesDropped, stalls, bytes } = element.player?.stats ?? {};
  const trouble = element.shadowRoot.querySelector(".card")?.innerText;
  await fetch("/report", {
    method: "POST",
    body: JSON.stringify({ framesShown, framesDropped, stalls, bytes, problems, trouble }),
  });
}
</script>""".replace("EVERY", str(EVERY_S))


def main() -> int:
    """Watch all browsers that are here; prints a line a minute for each, and whether all is well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--package", type=Path, default=REPOSITORY / "manifests" / "showcase" / "fox.airgs")
    options = parser.parse_args()
    here = [browser for browser in BROWSERS if not browser.missing()]
    failed: list[str] = []

    def run(browser: Browser) -> None:
        failed.extend(f"{browser.name}: {why}" for why in watch(browser, options.package, options.minutes))

    threads = [threading.Thread(target=run, args=(browser,)) for browser in here]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print("\n".join(failed) or f"{', '.join(browser.name for browser in here)}: memory is flat, no problem", flush=True)
    return bool(failed)


def watch(browser: Browser, package: Path, minutes: float) -> list[str]:
    reports: list[dict[str, Any]] = []

    def told(body: bytes) -> bytes:
        reports.append(json.loads(body))
        return b""

    sizes: list[int] = []
    shown: list[int] = []
    folders = {"page": PAGE, "package": package}
    with (
        serve(folders, {"/watch.html": WATCH.encode}, told) as site,
        browser.start(site.url + "/watch.html") as process,
    ):
        end = time.monotonic() + 60 * minutes
        while time.monotonic() < end:
            time.sleep(min(60, max(0, end - time.monotonic())))
            sizes.append(memory(process.pid))
            last = reports[-1] if reports else {}
            shown.append(last.get("framesShown") or 0)
            print(f"{browser.name:10} {len(sizes):3} min {sizes[-1] / 1e6:7.1f} MB {json.dumps(last)}", flush=True)
    return list(wrong(sizes, shown, reports[-1] if reports else {}))


def wrong(sizes: list[int], shown: list[int], last: dict[str, Any]) -> list[str]:
    """Sentences about memory (bytes) and frames minute by minute, and about the last report."""
    third = len(sizes) // 3
    middle, end = median(sizes[third : 2 * third] or [0]), median(sizes[2 * third :])
    sentences = [f"{what}: {last[what]}" for what in ("problems", "trouble") if last.get(what)]
    if any(after <= before for before, after in zip([0, *shown], shown, strict=False)):
        sentences.append(f"frames shown by the end of each minute: {shown}")
    if end > GROWN * middle:
        sentences.append(f"memory grew from {middle / 1e6:.1f} to {end / 1e6:.1f} MB")
    return sentences


def memory(session: int) -> int:
    """Bytes of all processes of a session, shared pages shared out (Linux, proc_pid_smaps)."""
    total = 0
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.getsid(int(folder.name)) != session:
                continue
            lines = (folder / "smaps_rollup").read_text().splitlines()
        except (OSError, ProcessLookupError):
            continue  # it has ended
        total += sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total


if __name__ == "__main__":
    sys.exit(main())
