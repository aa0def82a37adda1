"""What people read has no control characters, whatever descriptions and names contain."""

import io
import json
import logging

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.printable_text import PrintableFormatter, print_lines, printable, printable_lines

HOSTILE = "\x1b[31m\x07\r\x9b\u202e\u2028\ud800\U000e0041"


@given(st.text())
def test_no_text_has_control_characters(text: str) -> None:
    assert not [
        letter for letter in printable(text) if ord(letter) < 32 or 127 <= ord(letter) < 160
    ]


@pytest.mark.parametrize("letter", HOSTILE.replace("[31m", ""))
def test_each_hostile_character_is_escaped(letter: str) -> None:
    assert printable(letter).startswith("\\u")
    assert printable(letter).isascii()
    assert printable_lines(letter) == printable(letter)


def test_only_lines_keep_line_ends_and_tabs() -> None:
    assert printable("a\n\tb") == "a\\u000a\\u0009b"
    assert printable_lines("a\n\tb") == "a\n\tb"


@pytest.mark.parametrize("text", ["", "r1", "Größe 3 µm — 箱 🤖"])
def test_ordinary_text_is_unchanged(text: str) -> None:
    assert printable(text) == text


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_json_stays_the_same_json(text: str) -> None:
    assert json.loads(printable_lines(msgspec.json.encode(text).decode())) == text


def test_command_prints_no_control_characters(capsys: pytest.CaptureFixture[str]) -> None:
    print_lines(f"name {HOSTILE}")
    print_lines(HOSTILE, err=True, nl=False)

    printed = capsys.readouterr()
    assert printed.out.removesuffix("\n").isprintable()
    assert printed.err.isprintable()


def test_log_has_one_line_for_each_message() -> None:
    stream = io.StringIO()
    log, handler = logging.Logger("test"), logging.StreamHandler(stream)
    handler.setFormatter(PrintableFormatter("%(levelname)s %(message)s"))
    log.addHandler(handler)

    log.warning("entity=%s", f"r1\nERROR forged {HOSTILE}")

    assert stream.getvalue().count("\n") == 1
    assert stream.getvalue().removesuffix("\n").isprintable()
