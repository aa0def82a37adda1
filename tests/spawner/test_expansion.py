"""xacro: arguments, packages and includes; and one line for what cannot be expanded."""

from pathlib import Path

import pytest

from tests.spawner.packages import a_package
from zensim.spawner.expansion import arguments_of, expanded, needs_expansion
from zensim.spawner.markup import DescriptionError
from zensim.spawner.search_paths import search_paths

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
INCLUDE = HEAD + '<xacro:include filename="$(find parts)/urdf/part.xacro"/><xacro:part/></robot>'
PART = HEAD + '<xacro:macro name="part" params=""><link name="found"/></xacro:macro></robot>'


def a_xacro(folder: Path, text: str) -> Path:
    file = folder / "r.xacro"
    file.write_text(text)
    return file


@pytest.mark.parametrize(
    ("name", "text", "needed"),
    [
        ("r.xacro", "<robot/>", True),
        ("r.urdf.xacro", "<robot/>", True),
        ("r.urdf", HEAD + "</robot>", False),
        ("r.urdf", HEAD + '<xacro:arg name="a"/></robot>', True),
        ("r.urdf", "<robot><!--><xacro:imu/><--></robot>", False),
    ],
)
def test_file_is_expanded_when_it_is_xacro(name: str, text: str, needed: bool) -> None:  # noqa: FBT001
    assert needs_expansion(text, Path(name)) is needed


def test_arguments_are_read() -> None:
    assert arguments_of(["a:=1", "b:=x:=y", "c:="]) == {"a": "1", "b": "x:=y", "c": ""}


@pytest.mark.parametrize("word", ["a", "a=1", ":=1", ""])
def test_word_that_is_no_argument_is_refused(word: str) -> None:
    with pytest.raises(ValueError, match="use key:=value"):
        arguments_of([word])


def test_package_beside_is_found(tmp_path: Path) -> None:
    package = a_package(tmp_path)
    (a_package(tmp_path, "parts") / "urdf" / "part.xacro").write_text(PART)
    file = a_xacro(package / "urdf", INCLUDE)

    assert 'name="found"' in expanded(file.read_text(), file, {}, search_paths((), {}).beside(file))


@pytest.mark.parametrize("below", ["", "src"])
def test_package_in_the_search_paths_is_found(tmp_path: Path, below: str) -> None:
    (a_package(tmp_path / "ws" / below, "parts") / "urdf" / "part.xacro").write_text(PART)
    file = a_xacro(tmp_path, INCLUDE)

    assert 'name="found"' in expanded(
        file.read_text(), file, {}, search_paths([tmp_path / "ws"], {})
    )


def test_expansion_says_nothing_about_this_host(tmp_path: Path) -> None:
    file = a_xacro(tmp_path, HEAD + '<link name="${1 + 1}"/></robot>')

    text = expanded(file.read_text(), file, {}, search_paths((), {}))

    assert str(tmp_path) not in text
    assert '<link name="2"/>' in text


@pytest.mark.parametrize(
    "text",
    [
        "<robot",
        INCLUDE,
        HEAD + '<xacro:include filename="nowhere.xacro"/></robot>',
        HEAD + '<link name="$(arg nothing)"/></robot>',
        HEAD + '<link name="${undefined}"/></robot>',
        HEAD + "<xacro:nothing/></robot>",
        HEAD + '<link name="${1 / 0}"/></robot>',
        HEAD + '<xacro:macro name="m" params=""><xacro:m/></xacro:macro><xacro:m/></robot>',
    ],
    ids=["xml", "package", "include", "argument", "name", "macro", "division", "recursion"],
)
def test_file_that_cannot_be_expanded_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    file = a_xacro(tmp_path, text)

    with pytest.raises(DescriptionError, match=r"r\.xacro cannot be expanded: ") as caught:
        expanded(file.read_text(), file, {}, search_paths((), {}))

    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wish", ["7 ** 10 ** 9", "'a' * 10 ** 10"], ids=["time", "memory"])
def test_file_that_asks_for_too_much_is_refused_in_one_line(tmp_path: Path, wish: str) -> None:
    file = a_xacro(tmp_path, HEAD + f'<link name="${{{wish}}}"/></robot>')

    with pytest.raises(DescriptionError, match="it takes more than") as caught:
        expanded(file.read_text(), file, {}, search_paths((), {}))

    assert "\n" not in str(caught.value)
