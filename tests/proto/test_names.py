"""Validation of names, namespaces and frame ids."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.names import (
    FRAME_PATTERN,
    MAX_NAMESPACE_LENGTH,
    NAME_PATTERN,
    InvalidName,
    check_frame,
    check_name,
    check_namespace,
)

NAMES = st.from_regex(NAME_PATTERN, fullmatch=True)


@pytest.mark.parametrize("name", ["r", "R2D2", "box_bot_0", "a" * 64])
def test_check_name_returns_a_name(name: str) -> None:
    assert check_name(name) == name


@pytest.mark.parametrize(
    "name",
    [
        "",
        "0r",
        "_r",
        "r-1",
        "r 1",
        "r/1",
        "r\n",
        "r\x00",
        "*",
        "**",
        "$*",
        "@r",
        "..",
        "é",
        "a" * 65,
    ],
)
def test_check_name_refuses_invalid_names(name: str) -> None:
    with pytest.raises(InvalidName):
        check_name(name)


def test_check_name_names_the_kind_and_the_name() -> None:
    with pytest.raises(InvalidName, match="agent '0'"):
        check_name("0", "agent")


def test_check_name_truncates_a_long_name_in_its_error() -> None:
    with pytest.raises(InvalidName) as refusal:
        check_name("x" * 10_000)

    assert "xxx..." in str(refusal.value)
    assert len(str(refusal.value)) < 200


@given(name=st.text(max_size=70))
def test_check_name_returns_or_refuses_any_text(name: str) -> None:
    try:
        assert check_name(name) == name
    except InvalidName as refusal:
        text = str(refusal)
    else:
        text = ""

    assert "\n" not in text


@pytest.mark.parametrize(
    ("namespace", "bare"),
    [("r1", "r1"), ("/r1", "r1"), ("team/r1", "team/r1"), ("/a/b/c/d/e/f/g/h", "a/b/c/d/e/f/g/h")],
)
def test_check_namespace_returns_it_without_its_slash(namespace: str, bare: str) -> None:
    assert check_namespace(namespace) == bare


@given(chunks=st.lists(NAMES, min_size=1, max_size=8))
def test_check_namespace_accepts_names_joined_by_slashes(chunks: list[str]) -> None:
    namespace = "/".join(["robots", *chunks[1:]])[:MAX_NAMESPACE_LENGTH].rstrip("/")

    assert check_namespace(namespace) == namespace


@pytest.mark.parametrize(
    "namespace",
    [
        "",
        "/",
        "//r1",
        "r1/",
        "a//b",
        "team/*",
        "team/**",
        "team/r 1",
        "a/b/c/d/e/f/g/h/i",
        "team/@r",
    ],
)
def test_check_namespace_refuses_invalid_namespaces(namespace: str) -> None:
    with pytest.raises(InvalidName):
        check_namespace(namespace)


@pytest.mark.parametrize("namespace", ["sim", "/sim", "sim/r1", "world", "world/r1"])
def test_check_namespace_refuses_a_reserved_first_name(namespace: str) -> None:
    with pytest.raises(InvalidName):
        check_namespace(namespace)


def test_check_namespace_accepts_a_reserved_name_further_on() -> None:
    assert check_namespace("team/sim") == "team/sim"


@pytest.mark.parametrize("frame_id", ["odom", "r1/base_link", "map", "a.b-c", "0", "x" * 256])
def test_check_frame_returns_a_frame(frame_id: str) -> None:
    assert check_frame(frame_id) == frame_id
    assert FRAME_PATTERN.fullmatch(frame_id)


@pytest.mark.parametrize("frame_id", ["", "/odom", "base link", "odom\n", "x" * 257])
def test_check_frame_refuses_invalid_frames(frame_id: str) -> None:
    with pytest.raises(InvalidName):
        check_frame(frame_id)


def test_check_namespace_refuses_more_than_200_characters() -> None:
    levels = "/".join(["n" * 49] * 4) + "n"

    assert check_namespace(levels) == levels
    with pytest.raises(InvalidName, match=r"201.*200"):
        check_namespace(levels + "n")
