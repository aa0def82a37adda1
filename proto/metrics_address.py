"""Addresses at which programs offer health and metrics, and who may reach them."""

import re
from typing import Final

from zensim.proto.endpoints import Exposed, is_loopback

ADDRESS_PATTERN: Final = re.compile(r"(?:(?P<host>\[[0-9a-fA-F:.]+\]|[^\s:/]+):)?(?P<port>\d{1,5})")
LOOPBACK: Final = "127.0.0.1"
MAX_PORT: Final = 65535


class UnusableMetrics(ValueError):
    """Metrics cannot be served at the address, or their library is missing."""


def parse_metrics_address(text: str) -> tuple[str, int]:
    """Split `[HOST:]PORT`; without a host it is that of loopback.

    Raises:
        UnusableMetrics: It is not one.
    """
    match = ADDRESS_PATTERN.fullmatch(text)
    if match is None or int(match["port"]) > MAX_PORT:
        raise UnusableMetrics(
            f"`metrics` {text[:80]!r} is not valid; use PORT or HOST:PORT, as 9464"
        )
    return (match["host"] or LOOPBACK).strip("[]"), int(match["port"])


def is_exposed(address: str) -> bool:
    """Whether other hosts reach `[HOST:]PORT`; nobody reaches an empty one.

    Raises:
        UnusableMetrics: It is not valid.
    """
    return bool(address) and not is_loopback(parse_metrics_address(address)[0])


def check_metrics_exposure(command: str, address: str, *, is_insecure: bool) -> None:
    """Refuse to serve other hosts unless the user says so: there is neither TLS nor a token.

    Args:
        command: To type, with its verb.
        address: `[HOST:]PORT`; empty = nothing is served.
        is_insecure: Whether the user accepts that everybody reads health and metrics.

    Raises:
        Exposed: The address is not on loopback, and the user has not said so.
        UnusableMetrics: It is not valid.
    """
    if is_exposed(address) and not is_insecure:
        raise Exposed(
            f"everybody who reaches {address} could read health and metrics; type '{command} "
            f"--metrics {address} --metrics-insecure' in a network that you trust"
        )
