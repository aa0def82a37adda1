"""Addresses of health and metrics, and the decision that other hosts may read them."""

import pytest

from zensim.proto.endpoints import Exposed
from zensim.proto.metrics_address import (
    UnusableMetrics,
    check_metrics_exposure,
    parse_metrics_address,
)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("9464", ("127.0.0.1", 9464)),
        ("0.0.0.0:9464", ("0.0.0.0", 9464)),
        ("[::1]:0", ("::1", 0)),
        ("pods.example:80", ("pods.example", 80)),
    ],
)
def test_address_has_an_optional_host(text: str, address: tuple[str, int]) -> None:
    assert parse_metrics_address(text) == address


@pytest.mark.parametrize("text", ["", "host", "host:", ":", "70000", "::1:80", "1.2.3.4:x", "-1"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(UnusableMetrics):
        parse_metrics_address(text)


@pytest.mark.parametrize("address", ["", "9464", "127.0.0.1:9464", "[::1]:0", "localhost:80"])
def test_metrics_on_loopback_need_no_decision(address: str) -> None:
    check_metrics_exposure("zensim serve", address, is_insecure=False)


@pytest.mark.parametrize("address", ["0.0.0.0:9464", "[::]:9464", "10.0.0.5:0", "pods.example:80"])
def test_metrics_for_other_hosts_need_a_decision(address: str) -> None:
    with pytest.raises(Exposed):
        check_metrics_exposure("zensim serve", address, is_insecure=False)
    check_metrics_exposure("zensim serve", address, is_insecure=True)
