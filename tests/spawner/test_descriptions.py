"""Descriptions: where they come from, and what is no description."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.standard_messages import String
from zensim.spawner.descriptions import (
    Description,
    from_database,
    from_file,
    from_stream,
    from_topic,
    from_word,
    with_model_uris,
)
from zensim.spawner.markup import MAX_TEXT_BYTES, DescriptionError
from zensim.spawner.search_paths import SearchPaths, search_paths

if TYPE_CHECKING:
    from zensim.proto.bus import Bus

SDF = '<sdf version="1.6"><model name="m"/></sdf>'


def a_model(folder: Path, config: str = "", **files: str) -> SearchPaths:
    model = folder / "crate"
    model.mkdir()
    if config:
        (model / "model.config").write_text(config)
    for name, text in files.items():
        (model / f"{name}.sdf").write_text(text)
    return search_paths([folder], {})


def test_stream_is_expanded_when_it_is_xacro() -> None:
    text = (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="n" '
        'default="1"/><link name="l$(arg n)"/></robot>'
    )

    found = from_stream(BytesIO(text.encode()), {"n": "7"}, search_paths((), {}))

    assert '<link name="l7"/>' in found.text
    assert found.path is None


def test_stream_that_is_too_long_is_refused() -> None:
    with pytest.raises(ServiceError, match=r"xml.size: standard input has more than"):
        from_stream(BytesIO(b" " * (MAX_TEXT_BYTES + 9)), {}, search_paths((), {}))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_file_is_read_whatever_unicode_it_is(tmp_path: Path, encoding: str) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes('<robot name="räder"/>'.encode(encoding))

    assert from_file(file, {}, SearchPaths()).text == '<robot name="räder"/>'


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

    assert from_file(file, {}, SearchPaths()).text == f'{head}<robot name="räder"/>'


def test_file_is_read_when_only_a_comment_is_no_unicode(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(b'<!-- 30\xb0 --><robot name="r"/>')

    assert from_file(file, {}, SearchPaths()).text == '<!-- 30\ufffd --><robot name="r"/>'


def test_file_is_refused_unread_when_it_is_too_large(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    with file.open("wb") as large:
        large.truncate(MAX_TEXT_BYTES + 1)

    with pytest.raises(ServiceError, match=r"xml.size: .* at most 2097152"):
        from_file(file, {}, SearchPaths())


def test_word_is_a_shipped_model_or_left_to_the_server() -> None:
    shipped, other = (from_word(word, {}, SearchPaths()) for word in ("box_bot", "tank"))

    assert '<robot name="box_bot">' in shipped.text
    assert other == Description(uri="tank")


def test_database_takes_the_newest_file_that_the_model_names(tmp_path: Path) -> None:
    config = '<model><name>c</name><sdf version="1.4">old.sdf</sdf><sdf>new.sdf</sdf></model>'
    paths = a_model(tmp_path, config, old="<sdf/>", new=SDF)

    assert from_database("crate", {}, paths).text == SDF


def test_database_takes_model_sdf_when_nothing_is_named(tmp_path: Path) -> None:
    assert from_database("crate", {}, a_model(tmp_path, model=SDF)).text == SDF


def test_database_does_not_leave_the_models_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.sdf").write_text(SDF)
    paths = a_model(tmp_path, "<sdf>../secret.sdf</sdf>")

    with pytest.raises(FileNotFoundError, match="no such model"):
        from_database("crate", {}, paths)


@pytest.mark.parametrize("name", ["nothing", "../crate", "", ".."])
def test_database_has_no_such_model(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileNotFoundError, match="no such model"):
        from_database(name, {}, a_model(tmp_path, model=SDF))


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

    assert from_topic(cast("Bus", bus), "/a/b", 1.0).text == "<robot/>"


def test_topic_that_nobody_puts_is_waited_for_in_vain() -> None:
    with pytest.raises(TimeoutError, match=r"no description came on a/b within 0\.01 s"):
        from_topic(cast("Bus", MemoryBus()), "a/b", 0.01)


@pytest.mark.parametrize("key", ["", "/", "a//b", "a/*", "a b", "a/", "$x", "a?b", "a#b"])
def test_topic_that_is_no_key_is_refused(key: str) -> None:
    with pytest.raises(ValueError, match="is no key"):
        from_topic(cast("Bus", MemoryBus()), key, 0.01)


def test_package_uris_of_meshes_become_model_uris() -> None:
    text = '<robot a="package://a"><mesh scale="1" filename="package://p/a.stl"/></robot>'

    changed = with_model_uris(Description(text)).text

    assert changed == text.replace('filename="package://p', 'filename="model://p')


def test_text_that_is_no_unicode_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(b"<robot name='\xff'/>")

    with pytest.raises(DescriptionError, match="cannot be decoded: byte 13 is no utf-8"):
        from_file(file, {}, SearchPaths())
