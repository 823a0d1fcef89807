"""The sessions of the vectors hold what is rare, and what the numbers of a package leave out makes no difference."""

from collections import Counter

from airgs_codec.package.package import open_package
from airgs_codec.play.session import simulate
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.trace import Link, Trace
from tests.support.paths import GOLDEN
from tests.support.session_packages import offers_of
from tests.support.vectors import cases

SESSIONS = cases("sessions", "sessions")


def test_every_kind_of_event_is_there():
    rows = [row for session in SESSIONS for row in session["events"]]
    kinds = Counter(row[0] for row in rows)
    assert min(kinds[kind] for kind in ("tables", "group", "state", "shown")) > 100
    assert min(kinds["replacement"], kinds["replaced"], kinds["lost"]) > 20 and kinds["cut"]
    assert sum(row[7] for row in rows if row[0] in ("group", "state")) > 10, "given up"


def test_rules_and_policies_take_turns():
    rules = {(name, s["settings"].get(name)) for s in SESSIONS for name in ("abandon", "replace", "pipelined")}
    assert {(name, on) for name in ("abandon", "replace", "pipelined") for on in (False, True)} <= rules
    assert len({session["policy"] for session in SESSIONS}) == 9


def test_numbers_are_played_as_their_package_is():
    package = open_package(GOLDEN / "fox")
    numbers = next(case for case in cases("sessions", "packages") if case["name"] == "fox")
    link, rules = Link(Trace.open("markov:3:0.2"), 0.05), SessionSettings(loops=20)
    real, made = (simulate(source, link, "paper", rules) for source in (package, offers_of(numbers)))
    assert (real.fetches, real.shown) == (made.fetches, made.shown)
