"""Keys from the bytes of a terminal."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.terminal_keys import KeyEvent, KeyParser


@pytest.mark.parametrize(
    ("data", "event"),
    [
        (b"w", KeyEvent("w")),
        (b"W", KeyEvent("W")),
        (b" ", KeyEvent(" ")),
        (b"\x03", KeyEvent("ctrl+c")),
        (b"\r", KeyEvent("enter")),
        (b"\x1b[A", KeyEvent("up")),
        (b"\x1bOD", KeyEvent("left")),
        (b"\x1b[1;2C", KeyEvent("shift+right")),
        (b"\x1b[O", KeyEvent("focus_out")),
        (b"\x1b[I", KeyEvent("focus_in")),
        (b"\x1b[15~", KeyEvent("unknown")),
        (b"\x1b[119u", KeyEvent("w", has_release=True)),
        (b"\x1b[119;1:3u", KeyEvent("w", "release", has_release=True)),
        (b"\x1b[119;2:2u", KeyEvent("W", "repeat", has_release=True)),
        (b"\x1b[44;2u", KeyEvent("<", has_release=True)),
        (b"\x1b[99;5u", KeyEvent("ctrl+c", has_release=True)),
        (b"\x1b[119;3u", KeyEvent("unknown", has_release=True, base="w")),
        (b"\x1b[1;1:3A", KeyEvent("up", "release", has_release=True)),
        (b"\x1b[119;65u", KeyEvent("w", has_release=True)),
    ],
)
def test_bytes_are_the_key(data: bytes, event: KeyEvent) -> None:
    assert KeyParser().feed(data) == [event]


def test_shift_alone_is_no_key() -> None:
    assert KeyParser().feed(b"\x1b[57441;2u") == []


def test_escape_alone_is_a_key_when_nothing_follows() -> None:
    parser = KeyParser()

    events = [parser.feed(b"\x1b"), parser.flush(), parser.flush()]

    assert events == [[], [KeyEvent("escape")], []]


@pytest.mark.parametrize(("data", "has_pending"), [(b"w", False), (b"\x1b[", True)])
def test_unfinished_sequence_waits(*, data: bytes, has_pending: bool) -> None:
    parser = KeyParser()

    parser.feed(data)

    assert parser.has_pending == has_pending


@given(st.lists(st.sampled_from([b"w", b"\x1b[A", b"\x1b[119;1:3u", b"\x1bOB", b"\x1b[O"])))
def test_keys_are_the_same_however_the_bytes_are_cut(parts: list[bytes]) -> None:
    data = b"".join(parts)
    whole, cut = KeyParser(), KeyParser()

    assert len(whole.feed(data)) == len(parts)
    assert [one for byte in data for one in cut.feed(bytes([byte]))] == KeyParser().feed(data)


@given(st.binary(max_size=60))
def test_any_bytes_are_taken(data: bytes) -> None:
    parser = KeyParser()

    parser.feed(data)
    parser.flush()

    assert parser.feed(b"w") == [KeyEvent("w")]
