"""Patterns: POSIX extended regular expressions, found anywhere in names."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.sim_server.queries.entity_filters import PatternRefused, PosixPattern

NAMES = ("r1", "r10", "robot_2", "Box", "shelf_a1")


def found(pattern: str, names: tuple[str, ...] = NAMES) -> list[str]:
    return [name for some in PosixPattern(pattern).search(names) for name in some]


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("r1", ["r1", "r10"]),
        ("^r1$", ["r1"]),
        ("^r", ["r1", "r10", "robot_2"]),
        ("[[:upper:]]", ["Box"]),
        ("1$|^B", ["r1", "Box", "shelf_a1"]),
        ("(o|e){1}", ["robot_2", "Box", "shelf_a1"]),
        ("[^a-z0-9_]", ["Box"]),
        ("", list(NAMES)),
        ("x{2}", []),
        (".", list(NAMES)),
    ],
)
def test_pattern_is_found_anywhere_in_a_name(pattern: str, names: list[str]) -> None:
    assert found(pattern) == names


@pytest.mark.parametrize(
    "pattern",
    ["(", "a)(b", "a**(", "[z-a]", "a{99999}", r"\d", r"(a)\1", "(?i)a", "[[:no:]]", "\ud800"],
)
def test_what_is_no_posix_expression_is_refused_in_one_line(pattern: str) -> None:
    with pytest.raises(PatternRefused, match=r"filter\.pattern: ") as error:
        PosixPattern(pattern)

    assert "\n" not in str(error.value)


def test_a_long_pattern_is_refused() -> None:
    with pytest.raises(PatternRefused, match="2000 characters are too many; use at most 1024"):
        PosixPattern("a" * 2000)


@pytest.mark.parametrize(
    ("pattern", "least", "most"),
    [("^r[0-9]+$", 1, 4), ("^(a+)+$", 1, 4), ("(a?){500}a{500}", 50, 300)],
    ids=["plain", "nested", "large"],
)
def test_the_larger_a_pattern_the_fewer_names_it_is_looked_for_in_at_a_turn(
    pattern: str, least: int, most: int
) -> None:
    names = tuple("a" * 60 + f"{i:04}" for i in range(300))

    found_at_turns = list(PosixPattern(pattern).search(names))

    assert least <= len(found_at_turns) <= most
    assert not any(found_at_turns)


@settings(max_examples=25)
@given(
    st.from_regex(r"\A[ab]?(\[ab\]|a\*|b\+|\(a\|b\)|\.)[ab]?\Z"),
    st.lists(st.from_regex(r"\A[abc]{1,6}\Z"), max_size=20, unique=True),
)
def test_pattern_finds_what_the_re_of_python_finds(pattern: str, names: list[str]) -> None:
    assert found(pattern, tuple(names)) == [name for name in names if re.search(pattern, name)]
