"""Attempts to open a session: which are repeated, how often, and which end at once."""

import time
from typing import TYPE_CHECKING

import pytest

from zensim.proto.bus import bus_session
from zensim.proto.bus.bus_config import BusConfig, Credentials
from zensim.proto.bus.bus_errors import BusError, EndpointUnreachable, JoinRefused
from zensim.proto.bus.bus_session import LEAST_ATTEMPT_S, open_bus_with_retry

if TYPE_CHECKING:
    from collections.abc import Iterator

OWN = BusConfig(credentials=Credentials(user="server", password="", authority=""))
BUSY = JoinRefused("user", "the server is full or too busy")


class Attempts:
    def __init__(self, *outcomes: BusError) -> None:
        self.outcomes: Iterator[BusError] = iter(outcomes)
        self.times_s: list[float] = []

    def __call__(self, config: BusConfig) -> BusConfig:
        self.times_s.append(time.monotonic())
        for error in self.outcomes:
            raise error
        return config


def test_attempts_follow_each_other_with_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    attempts = Attempts(EndpointUnreachable(), EndpointUnreachable())
    monkeypatch.setattr(bus_session, "open_bus", attempts)

    open_bus_with_retry(BusConfig(), 60.0)

    first, second, third = attempts.times_s
    assert second - first >= LEAST_ATTEMPT_S * 0.9
    assert third - second >= LEAST_ATTEMPT_S * 0.9


def test_server_whose_router_is_busy_tries_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_session, "open_bus", Attempts(BUSY, BUSY))

    assert open_bus_with_retry(OWN, 60.0) is not None
    monkeypatch.setattr(bus_session, "open_bus", Attempts(BUSY))
    with pytest.raises(JoinRefused):
        open_bus_with_retry(OWN, 0.0)


@pytest.mark.parametrize(
    ("config", "error"),
    [(BusConfig(), BUSY), (OWN, JoinRefused("revoked", "revoked")), (OWN, BusError("other"))],
)
def test_refusal_ends_the_attempts(
    config: BusConfig, error: BusError, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempts = Attempts(error)
    monkeypatch.setattr(bus_session, "open_bus", attempts)

    with pytest.raises(type(error)):
        open_bus_with_retry(config, 60.0)

    assert len(attempts.times_s) == 1
