"""Descriptions: where they come from, and what is no description."""

import re
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.spawner.packages import a_package
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.standard_messages import String
from zensim.spawner.spawn.description_sources import (
    RobotDescription,
    expand_xacro,
    find_model_by_name,
    is_xacro,
    parse_xacro_arguments,
    read_description_file,
    read_description_stream,
    read_model_argument,
    receive_description,
    to_model_uris,
)
from zensim.spawner.spawn.description_xml import MAX_TEXT_BYTES, DescriptionError
from zensim.spawner.spawn.search_paths import SearchPaths, collect_search_paths

if TYPE_CHECKING:
    from zensim.proto.bus import Bus

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
    assert is_xacro(text, Path(name)) is needed


def test_arguments_are_read() -> None:
    assert parse_xacro_arguments(["a:=1", "b:=x:=y", "c:="]) == {"a": "1", "b": "x:=y", "c": ""}


@pytest.mark.parametrize("word", ["a", "a=1", ":=1", ""])
def test_word_that_is_no_argument_is_refused(word: str) -> None:
    with pytest.raises(ValueError, match="use key:=value"):
        parse_xacro_arguments([word])


def test_package_beside_is_found(tmp_path: Path) -> None:
    package = a_package(tmp_path)
    (a_package(tmp_path, "parts") / "urdf" / "part.xacro").write_text(PART)
    file = a_xacro(package / "urdf", INCLUDE)

    assert 'name="found"' in expand_xacro(
        file.read_text(), file, {}, collect_search_paths((), {}).beside(file)
    )


@pytest.mark.parametrize("below", ["", "src"])
def test_package_in_the_search_paths_is_found(tmp_path: Path, below: str) -> None:
    (a_package(tmp_path / "ws" / below, "parts") / "urdf" / "part.xacro").write_text(PART)
    file = a_xacro(tmp_path, INCLUDE)

    assert 'name="found"' in expand_xacro(
        file.read_text(), file, {}, collect_search_paths([tmp_path / "ws"], {})
    )


def test_expansion_says_nothing_about_this_host(tmp_path: Path) -> None:
    file = a_xacro(tmp_path, HEAD + '<link name="${1 + 1}"/></robot>')

    text = expand_xacro(file.read_text(), file, {}, collect_search_paths((), {}))

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

    with pytest.raises(DescriptionError, match=r"r\.xacro") as caught:
        expand_xacro(file.read_text(), file, {}, collect_search_paths((), {}))

    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wish", ["7 ** 10 ** 9", "'a' * 10 ** 10"], ids=["time", "memory"])
def test_file_that_asks_for_too_much_is_refused_in_one_line(tmp_path: Path, wish: str) -> None:
    file = a_xacro(tmp_path, HEAD + f'<link name="${{{wish}}}"/></robot>')

    with pytest.raises(DescriptionError, match=r"r\.xacro") as caught:
        expand_xacro(file.read_text(), file, {}, collect_search_paths((), {}))

    assert "\n" not in str(caught.value)


SDF = '<sdf version="1.6"><model name="m"/></sdf>'


def a_model(folder: Path, config: str = "", **files: str) -> SearchPaths:
    model = folder / "crate"
    model.mkdir()
    if config:
        (model / "model.config").write_text(config)
    for name, text in files.items():
        (model / f"{name}.sdf").write_text(text)
    return collect_search_paths([folder], {})


def test_stream_is_expanded_when_it_is_xacro() -> None:
    text = (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="n" '
        'default="1"/><link name="l$(arg n)"/></robot>'
    )

    found = read_description_stream(
        BytesIO(text.encode()), {"n": "7"}, collect_search_paths((), {})
    )

    assert '<link name="l7"/>' in found.text
    assert found.path is None


def test_stream_that_is_too_long_is_refused() -> None:
    with pytest.raises(ServiceError, match=r"xml\.size: "):
        read_description_stream(
            BytesIO(b" " * (MAX_TEXT_BYTES + 9)), {}, collect_search_paths((), {})
        )


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_file_is_read_whatever_unicode_it_is(tmp_path: Path, encoding: str) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes('<robot name="räder"/>'.encode(encoding))

    assert read_description_file(file, {}, SearchPaths()).text == '<robot name="räder"/>'


@pytest.mark.parametrize(
    ("head", "encoding"),
    [
        ('<?xml version="1.0" encoding="ISO-8859-1"?>', "latin-1"),
        ("<?xml version='1.0' encoding='windows-1252' ?>", "cp1252"),
    ],
)
def test_file_is_read_in_the_latin_that_it_declares(
    tmp_path: Path, head: str, encoding: str
) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(f'{head}<robot name="räder"/>'.encode(encoding))

    assert read_description_file(file, {}, SearchPaths()).text == f'{head}<robot name="räder"/>'


def test_file_is_read_when_only_a_comment_is_no_unicode(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(b'<!-- 30\xb0 --><robot name="r"/>')

    assert (
        read_description_file(file, {}, SearchPaths()).text == '<!-- 30\ufffd --><robot name="r"/>'
    )


def test_file_is_refused_unread_when_it_is_too_large(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    with file.open("wb") as large:
        large.truncate(MAX_TEXT_BYTES + 1)

    with pytest.raises(ServiceError, match=rf"xml\.size: .*{MAX_TEXT_BYTES}"):
        read_description_file(file, {}, SearchPaths())


def test_word_is_a_shipped_model_or_left_to_the_server() -> None:
    shipped, other = (read_model_argument(word, {}, SearchPaths()) for word in ("box_bot", "tank"))

    assert '<robot name="box_bot">' in shipped.text
    assert other == RobotDescription(uri="tank")


def test_database_takes_the_newest_file_that_the_model_names(tmp_path: Path) -> None:
    config = '<model><name>c</name><sdf version="1.4">old.sdf</sdf><sdf>new.sdf</sdf></model>'
    paths = a_model(tmp_path, config, old="<sdf/>", new=SDF)

    assert find_model_by_name("crate", {}, paths).text == SDF


def test_database_takes_model_sdf_when_nothing_is_named(tmp_path: Path) -> None:
    assert find_model_by_name("crate", {}, a_model(tmp_path, model=SDF)).text == SDF


def test_database_does_not_leave_the_models_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.sdf").write_text(SDF)
    paths = a_model(tmp_path, "<sdf>../secret.sdf</sdf>")

    with pytest.raises(FileNotFoundError, match="crate"):
        find_model_by_name("crate", {}, paths)


@pytest.mark.parametrize("name", ["nothing", "../crate", "", ".."])
def test_database_has_no_such_model(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileNotFoundError):
        find_model_by_name(name, {}, a_model(tmp_path, model=SDF))


@pytest.mark.parametrize("format_", Format)
def test_topic_is_read_in_each_form(format_: Format) -> None:
    bus = MemoryBus()
    bus.pumps.append(lambda: None)
    subscribe = bus.subscribe

    def subscribe_and_put(key: str, depth: int = 1) -> object:
        subscription = subscribe(key, depth)
        bus.put_message(key, String("<robot/>"), format_)
        return subscription

    bus.subscribe = subscribe_and_put  # type: ignore[method-assign,assignment]

    assert receive_description(cast("Bus", bus), "/a/b", 1.0).text == "<robot/>"


def test_topic_that_nobody_puts_is_waited_for_in_vain() -> None:
    with pytest.raises(TimeoutError, match=r"a/b.*0\.01 s"):
        receive_description(cast("Bus", MemoryBus()), "a/b", 0.01)


@pytest.mark.parametrize("key", ["", "/", "a//b", "a/*", "a b", "a/", "$x", "a?b", "a#b"])
def test_topic_that_is_no_key_is_refused(key: str) -> None:
    with pytest.raises(ValueError, match=re.escape(repr(key))):
        receive_description(cast("Bus", MemoryBus()), key, 0.01)


def test_package_uris_of_meshes_become_model_uris() -> None:
    text = '<robot a="package://a"><mesh scale="1" filename="package://p/a.stl"/></robot>'

    changed = to_model_uris(RobotDescription(text)).text

    assert changed == text.replace('filename="package://p', 'filename="model://p')


def test_text_that_is_no_unicode_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(b"<robot name='\xff'/>")

    with pytest.raises(DescriptionError, match=r"byte 13.*utf-8"):
        read_description_file(file, {}, SearchPaths())
