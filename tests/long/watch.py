"""Somebody leaves a player on: a package that plays on and on in every browser, whose memory is looked at.

All browsers play at once, in small pictures, so that drawing in software leaves time to the rest. The player compares
the checksum of every picture that it decodes, and what it reports as a problem is counted here. Memory is the
proportional set size of a browser's processes. It is wrong where a problem was reported, nothing was shown in some
minute, or the median of the last third is more than GROWN times that of the middle third.
"""

import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from tests.support.browser import serve
from tests.support.browsers import BROWSERS, Browser
from tests.support.paths import CORPUS, PACKAGE

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
  const body = JSON.stringify({ framesShown, framesDropped, stalls, bytes, problems, trouble });
  await fetch("/report", { method: "POST", body });
}
</script>""".replace("EVERY", str(EVERY_S))


def watch_browsers(times: int, seed: int, folder: Path) -> Iterator[tuple[str, str]]:
    here = [browser for browser in BROWSERS if not browser.missing()]
    with ThreadPoolExecutor(len(here) or 1) as pool:
        for browser, found in zip(here, pool.map(partial(watch, minutes=times), here), strict=True):
            yield browser.name, "; ".join(found)


def watch(browser: Browser, minutes: float) -> list[str]:
    reports: list[dict[str, Any]] = []
    sizes: list[int] = []
    shown: list[int] = []

    def told(body: bytes) -> bytes:
        reports.append(json.loads(body))
        return b""

    folders = {"page": PACKAGE / "serve" / "page", "package": CORPUS / "showcase" / "fox.airgs"}
    site = serve(folders, {"/watch.html": WATCH.encode}, told)
    with site as here, browser.start(here.url + "/watch.html") as process:
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
