"""Listening on an address of other hosts needs a decision."""

import pytest

from zensim.proto.endpoints import Exposed, check_exposure


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tls/192.168.1.5:7447", "tcp/robot.example.org:1"],
)
def test_exposed_endpoint_is_refused_with_the_line_to_type(endpoint: str) -> None:
    with pytest.raises(Exposed, match="zensim serve --secure --listen tls/"):
        check_exposure("zensim serve", [endpoint], is_secure=False, is_insecure=False)


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/[::1]:1", "tcp/localhost:7447"])
def test_loopback_needs_no_decision(endpoint: str) -> None:
    check_exposure("zensim serve", [endpoint], is_secure=False, is_insecure=False)


@pytest.mark.parametrize(("is_secure", "is_insecure"), [(True, False), (False, True)])
def test_decision_opens_it(is_secure: bool, is_insecure: bool) -> None:  # noqa: FBT001
    check_exposure("zensim serve", ["tcp/0.0.0.0:1"], is_secure=is_secure, is_insecure=is_insecure)


def test_both_decisions_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="exclude"):
        check_exposure("zensim serve", [], is_secure=True, is_insecure=True)
