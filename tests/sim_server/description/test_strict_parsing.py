"""Strict parsing of numbers, with limits."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.strict_parsing import read_number, read_numbers
from zensim.sim_server.errors import ModelError


def read(text: str, *counts: int) -> tuple[float, ...]:
    return read_numbers(text, counts=counts, where="mass", slug="urdf.number")


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_number_formatted_by_python_is_parsed(number: float) -> None:
    assert read_number(f" {number!r}\n", where="mass", slug="s") == number


@pytest.mark.parametrize("text", ["1", "-1.", "+.5", "1e3", "1.5E-3", "007"])
def test_number_is_read_when_it_is_decimal(text: str) -> None:
    assert read(text, 1) == (float(text),)


@pytest.mark.parametrize(
    "text", ["nan", "inf", "-Infinity", "1_000", "0x10", "1,5", "٣", "1e", ".", "1e999"]
)
def test_number_is_refused_when_it_is_not_decimal_and_finite(text: str) -> None:
    with pytest.raises(ModelError, match="mass: ") as caught:
        read(text, 1)

    assert caught.value.slug == "urdf.number"


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("${x}", "run xacro"),
        ("$(arg mass)", "--xacro-arg"),
        ("$(env MASS)", "environment variable"),
        ("0 $(optenv TILT 0 1) 1", "zensim spawn FILE"),
        ("$(find robot)/mass", "package://"),
        ("$(eval 1 + 1)", "run xacro"),
    ],
)
def test_number_is_refused_with_what_expands_it(text: str, remedy: str) -> None:
    with pytest.raises(ModelError, match=remedy) as caught:
        read(text, 1, 3)

    assert (caught.value.slug, caught.value.code) == ("urdf.xacro", SpawnCode.UNSUPPORTED_FORMAT)


def test_numbers_are_refused_when_their_count_is_wrong() -> None:
    with pytest.raises(ModelError, match=r"'1 2'.*1 or 3") as caught:
        read("1 2", 1, 3)

    assert caught.value.slug == "urdf.number"


def test_number_is_refused_in_one_short_line_when_it_is_long() -> None:
    with pytest.raises(ModelError) as caught:
        read("1" * 100_000, 1)

    assert len(caught.value.message) < 200


def test_number_has_at_most_400_characters() -> None:
    assert read(f"0.{'0' * 397}1", 1) == (0.0,)
    with pytest.raises(ModelError):
        read(f"0.{'0' * 398}1", 1)
