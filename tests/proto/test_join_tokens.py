"""Join tokens: written, parsed, refused when damaged, and not printed."""

from pathlib import Path

import msgspec
import pytest

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.join_tokens import (
    InvalidToken,
    JoinToken,
    complete_address,
    forget_token,
    hide_token,
    is_join_address,
    parse_join_token,
    read_join_address,
    store_token,
)

TOKEN = JoinToken("tls/203.0.113.125:27447", "operator", bytes(range(16)), bytes(range(32)))
MAX_CHARACTERS = 128


@pytest.mark.parametrize(
    "token",
    [
        TOKEN,
        JoinToken("tls/[2001:db8::1]:7447", "r1", bytes(16), bytes(32), "warehouse"),
        JoinToken("tls/h:1", "r1", bytes(16), bytes(32), "default", bytes(400), bytes(138)),
    ],
)
def test_token_is_parsed_as_it_was_written(token: JoinToken) -> None:
    assert parse_join_token(token.write()) == token


def test_token_is_short() -> None:
    assert len(TOKEN.write()) <= MAX_CHARACTERS


def test_damaged_start_of_a_token_is_not_taken_for_an_endpoint() -> None:
    with pytest.raises(InvalidToken, match="join token"):
        open_bus(BusConfig(connect=("zs1garbage",)))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "zs1",
        "zs2" + TOKEN.write()[3:],
        TOKEN.write()[:-4],
        TOKEN.write().replace(".", "."[:0], 1),
        TOKEN.write() + ".x",
        TOKEN.write().replace("MjAz", "!!!!"),
        JoinToken("tls/h:1", "a/b", bytes(16), bytes(32)).write(),
        JoinToken("tls/h:1", "r1", bytes(15), bytes(32)).write(),
    ],
)
def test_damaged_token_is_refused_without_quoting_it(text: str) -> None:
    with pytest.raises(InvalidToken) as caught:
        parse_join_token(text)

    assert TOKEN.password_text not in str(caught.value)
    assert caught.value.__cause__ is None


def test_address_is_a_token_or_a_file_with_one(tmp_path: Path) -> None:
    (tmp_path / "t").write_text(f"{TOKEN.write()}\n")

    assert read_join_address(TOKEN.write()) == read_join_address(f"@{tmp_path / 't'}") == TOKEN
    assert [is_join_address(one) for one in (TOKEN.write(), "@t", "tcp/h:1", "")] == [
        *(True, True, False, False)
    ]


def test_file_has_the_certificate_for_zenoh(tmp_path: Path) -> None:
    token = msgspec.structs.replace(TOKEN, certificate=bytes(400), private_key=bytes(range(138)))
    file = tmp_path / "t"
    file.write_text(token.write_file())

    assert read_join_address(f"@{file}") == msgspec.structs.replace(token, file=str(file))
    file.write_text(token.write_file().replace("PRIVATE", "PUBLIC"))
    with pytest.raises(InvalidToken):
        read_join_address(f"@{file}")


def test_kept_token_is_for_its_endpoint_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))

    path = store_token(TOKEN)

    assert complete_address(TOKEN.endpoint) == f"@{path}"
    assert [complete_address(one) for one in ("tls/h:1", "tcp/203.0.113.125:27447")] == [
        *("tls/h:1", "tcp/203.0.113.125:27447")
    ]
    forget_token(TOKEN.endpoint)
    assert complete_address(TOKEN.endpoint) == TOKEN.endpoint
    with pytest.raises(InvalidToken):
        forget_token(TOKEN.endpoint)


def test_printed_forms_have_no_secret() -> None:
    assert TOKEN.password_text not in repr(TOKEN)
    assert hide_token(TOKEN.write()) == TOKEN.endpoint
    assert TOKEN.password_text not in hide_token(TOKEN.write()[:-3])
    assert hide_token("tcp/h:1") == "tcp/h:1"
