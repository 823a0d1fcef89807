"""What an audience costs: measured bytes and requests times prices that the reader gives.

The default prices are examples, round numbers to make the arithmetic visible; they are nobody's quotes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from airgs_codec._settings import setting
from airgs_codec.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Prices:
    """Prices in one currency; the defaults are examples. Raises ConfigError for a negative one."""

    edge_gb: float = setting(0.02, "price for 10^9 bytes from the edge to viewers")
    edge_million: float = setting(0.75, "price for 10^6 requests to the edge")
    origin_gb: float = setting(0.05, "price for 10^9 bytes from the origin to the edge")
    origin_million: float = setting(0.40, "price for 10^6 requests to the origin")
    storage_gb_month: float = setting(0.02, "price for 10^9 bytes kept for a month")
    encode_core_hour: float = setting(0.05, "price for a core and an hour")

    def __post_init__(self) -> None:
        for field in fields(self):
            if not getattr(self, field.name) >= 0:
                raise ConfigError(f"{field.name}: expected a price of 0 or more, got {getattr(self, field.name):g}")


@dataclass(frozen=True, slots=True)
class Measured:
    """What was measured of a package and its crowd."""

    viewer_mbps: float  # from the edge, with headers, while a viewer watches
    viewer_requests_s: float
    byte_hit_rate: float
    request_hit_rate: float
    stored_mb_minute: float  # of media, all rungs
    encode_core_s_second: float = 0.0  # core seconds to encode a second of media


@dataclass(frozen=True, slots=True)
class Cost:
    """A bill, in the currency of the prices."""

    edge_bytes: float
    edge_requests: float
    origin_bytes: float
    origin_requests: float
    storage: float
    encoding: float

    @property
    def total(self) -> float:
        """All of it."""
        return sum(getattr(self, field.name) for field in fields(self))


def cost(measured: Measured, prices: Prices, viewer_hours: float, media_hours: float, months: float = 1.0) -> Cost:
    """The bill for so many hours watched of a programme of `media_hours` that is kept for some months."""
    gigabytes = viewer_hours * 3600 * measured.viewer_mbps / 8e3
    millions = viewer_hours * 3600 * measured.viewer_requests_s / 1e6
    return Cost(
        edge_bytes=gigabytes * prices.edge_gb,
        edge_requests=millions * prices.edge_million,
        origin_bytes=gigabytes * (1 - measured.byte_hit_rate) * prices.origin_gb,
        origin_requests=millions * (1 - measured.request_hit_rate) * prices.origin_million,
        storage=media_hours * 60 * measured.stored_mb_minute / 1e3 * months * prices.storage_gb_month,
        encoding=media_hours * measured.encode_core_s_second * prices.encode_core_hour,
    )
