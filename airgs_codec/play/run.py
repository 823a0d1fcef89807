"""How a player is started: it fetches all of a scene, or the tiles that its viewer is expected to see."""

from __future__ import annotations

from collections.abc import Iterator

from airgs_codec.errors import ConfigError
from airgs_codec.play.catalogue import Catalogue
from airgs_codec.play.downloader import Connection, Downloader, Steps, answer
from airgs_codec.play.events import Event
from airgs_codec.play.player import Player
from airgs_codec.play.policies.state import Policy
from airgs_codec.play.settings import SessionSettings
from airgs_codec.play.sight import View
from airgs_codec.play.view_player import ViewPlayer


def run(
    catalogue: Catalogue,
    downloader: Downloader,
    policy: Policy,
    settings: SessionSettings | None = None,
    view: View | None = None,
) -> Iterator[Event]:
    """Play a package from the first request to the last picture; with a `view`, by tiles.

    Raises ConfigError where the policy needs quality that was not measured and where all rungs of the first segment are
    over the budget, TransportError when the link fails.
    """
    return answer(play_steps(catalogue, downloader, policy, settings, view), downloader)


def play_steps(
    catalogue: Catalogue,
    connection: Connection,
    policy: Policy,
    settings: SessionSettings | None = None,
    view: View | None = None,
) -> Steps:
    """The same as steps of a player that fetches nothing itself: whoever runs it sends the arrival of every `Wanted`,
    and None after every event, so that many players can share one thread.

    Raises ConfigError where the policy needs quality that was not measured.
    """
    if policy.needs_quality and not catalogue.measured:
        raise ConfigError(
            f"policy {policy.name}: the package has no measured quality, encode it without --measure-pictures 0"
        )
    rules = settings or SessionSettings()
    if view is None or catalogue.manifest.tiles == 1:
        return Player(catalogue, connection, policy, rules).play()
    return ViewPlayer(catalogue, connection, policy, rules.by_view(), view=view).play()
