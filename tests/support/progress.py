"""What a command says of its progress in a log."""

import re
from pathlib import Path


def stages_of(log: str, what: str | Path) -> list[str]:
    """Return the stages of a log; its first line of progress says what to expect, and the share of all only grows."""
    expected = rf"[^\n]*{re.escape(str(what))}: about \d+ \w+, then about [\d.]+ MB"
    lines = [line for line in log.splitlines() if re.fullmatch(rf"{expected}|.*: \d+% after \d+ s.*", line)]
    assert re.fullmatch(expected, lines[0])
    shown = [re.match(r"([^:]+).*: (\d+)% after", line).groups() for line in lines[1:]]
    shares = [int(share) for _, share in shown]
    assert shares == sorted(shares)
    return list(dict.fromkeys(stage for stage, _ in shown))
