"""Joins that a router refused, from lines of Zenoh's log."""

import pytest

from zensim.sim_server.security.join_log import JoinLog
from zensim.sim_server.security.user_sessions import SessionChange

ACCEPT = "\x1b[2mzenoh_transport::unicast::establishment::accept\x1b[0m\x1b[2m:\x1b[0m "
TLS = "\x1b[2m2026-11-23T09:15:26Z\x1b[0m DEBUG acc-0 ThreadId(05) zenoh_link_tls::unicast: "


def connected(address: str) -> str:
    return f"{TLS}Accepted TLS connection on 127.0.0.1:38313: {address}. Common Name: None."


def password(word: str = "password") -> str:
    return f"{ACCEPT}UsrPwd extension - Recv OpenSyn. Invalid {word}. at usrpwd.rs:424."


def read(*lines: str) -> list[SessionChange]:
    log = JoinLog()
    return [found for line in lines if (found := log.read(line))]


@pytest.mark.parametrize(
    ("word", "reason"),
    [("password", "wrong password"), ("user", "unknown, revoked or expired user")],
)
def test_refused_password_is_found_with_its_address(word: str, reason: str) -> None:
    found = read(connected("[::1]:7"), password(word))

    assert found == [SessionChange(action="refused", address="tls/[::1]:7", reason=reason)]


def test_other_outcomes_are_no_refusals() -> None:
    lines = [
        connected("10.0.0.1:1"),
        f"{ACCEPT}Connection reset by peer (os error 104)",
        connected("10.0.0.1:2"),
        f"{ACCEPT}New transport link accepted from a to b: tls/10.0.0.1:2",
        connected("10.0.0.2:3"),
        password(),
    ]

    assert [one.address for one in read(*lines)] == ["tls/10.0.0.2:3"]


def test_address_is_what_all_open_handshakes_have_in_common() -> None:
    one_host = read(connected("10.0.0.1:1"), connected("10.0.0.1:2"), password())
    two_hosts = read(connected("10.0.0.1:1"), connected("10.0.0.2:2"), password())

    assert [one.address for one in (*one_host, *two_hosts)] == ["tls/10.0.0.1", ""]


def test_certificate_that_is_refused_has_no_address() -> None:
    line = f"{TLS}invalid peer certificate: UnknownIssuer. Hint: increase the system open file"

    assert [(one.reason, one.address) for one in read(line)] == [("certificate refused", "")]


def test_lines_of_any_text_are_read() -> None:
    assert read("", "\x1b[31m", "Accepted TLS connection on", password()) != []
