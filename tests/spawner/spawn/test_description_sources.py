"""Descriptions from files, streams, models and topics; xacro."""

import sys
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.spawner.packages import make_package
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.standard_messages import String
from zensim.spawner.spawn import description_sources
from zensim.spawner.spawn.description_sources import (
    RobotDescription,
    expand_substitution_args,
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
    from zensim.proto.bus.bus_session import Bus

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
INCLUDE = HEAD + '<xacro:include filename="$(find parts)/urdf/part.xacro"/><xacro:part/></robot>'
PART = HEAD + '<xacro:macro name="part" params=""><link name="found"/></xacro:macro></robot>'


def make_xacro(folder: Path, text: str) -> Path:
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
def test_xacro_files_are_recognised(name: str, text: str, needed: bool) -> None:  # noqa: FBT001
    assert is_xacro(text, Path(name)) is needed


def test_arguments_are_parsed() -> None:
    assert parse_xacro_arguments(["a:=1", "b:=x:=y", "c:="]) == {"a": "1", "b": "x:=y", "c": ""}


@pytest.mark.parametrize("word", ["a", "a=1", ":=1", ""])
def test_invalid_argument_is_refused(word: str) -> None:
    with pytest.raises(ValueError, match="key:=value"):
        parse_xacro_arguments([word])


def test_sibling_package_is_found(tmp_path: Path) -> None:
    package = make_package(tmp_path)
    (make_package(tmp_path, "parts") / "urdf" / "part.xacro").write_text(PART)
    file = make_xacro(package / "urdf", INCLUDE)

    assert 'name="found"' in expand_xacro(
        file.read_text(), file, {}, collect_search_paths((), {}).with_folder_of(file)
    )


@pytest.mark.parametrize("below", ["", "src"])
def test_package_in_the_search_paths_is_found(tmp_path: Path, below: str) -> None:
    (make_package(tmp_path / "ws" / below, "parts") / "urdf" / "part.xacro").write_text(PART)
    file = make_xacro(tmp_path, INCLUDE)

    assert 'name="found"' in expand_xacro(
        file.read_text(), file, {}, collect_search_paths([tmp_path / "ws"], {})
    )


def test_expansion_does_not_contain_paths_of_this_host(tmp_path: Path) -> None:
    file = make_xacro(tmp_path, HEAD + '<link name="${1 + 1}"/></robot>')

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
def test_invalid_xacro_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    file = make_xacro(tmp_path, text)

    with pytest.raises(DescriptionError, match=r"r\.xacro") as caught:
        expand_xacro(file.read_text(), file, {}, collect_search_paths((), {}))

    assert "\n" not in str(caught.value)


WITHIN_2_S = """
import zensim.spawner.spawn.xacro_process as program
program.LIMITS = program.LIMITS._replace(total_cpu_s=2)
program.main()
"""


@pytest.mark.parametrize("text", ["7 ** 10 ** 9", "'a' * 10 ** 10"], ids=["time", "memory"])
def test_expensive_xacro_is_refused_in_one_line(
    tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = make_xacro(tmp_path, HEAD + f'<link name="${{{text}}}"/></robot>')
    monkeypatch.setattr(description_sources, "XACRO_COMMAND", (sys.executable, "-c", WITHIN_2_S))

    with pytest.raises(DescriptionError, match="more than") as caught:
        expand_xacro(file.read_text(), file, {}, collect_search_paths((), {}))

    assert "\n" not in str(caught.value)


ARGUMENTS = {"mass": "2.5", "label": 'a<"b"', "nested": "$(env SECRET)"}
ENVIRONMENT = {"TILT": "0 0 1", "SECRET": "s"}


@pytest.mark.parametrize(
    ("text", "expanded"),
    [
        ('rpy="$(optenv TILT 1 2 3)"', 'rpy="0 0 1"'),
        ('rpy="$(optenv OTHER 0 -1.5708 3.1416)"', 'rpy="0 -1.5708 3.1416"'),
        ('rpy="$(optenv OTHER)"', 'rpy=""'),
        ('rpy="$(env TILT)"', 'rpy="0 0 1"'),
        ('rpy="$(env OTHER)"', 'rpy="$(env OTHER)"'),
        ('mass="$( arg  mass )"', 'mass="2.5"'),
        ('mass="$(arg other)"', 'mass="$(arg other)"'),
        ('name="$(arg label)"', 'name="a&lt;&quot;b&quot;"'),
        ('name="$(arg nested)"', 'name="$(env SECRET)"'),
        ('name="$$(arg mass)"', 'name="$$(arg mass)"'),
        ('mesh="file://$(find parts)/m/a.dae"', 'mesh="package://parts/m/a.dae"'),
        ("<parameters>$(find parts)/c.yaml</parameters>", "<parameters>package://parts/c.yaml</parameters>"),
        ('value="$(eval 1 + 1) ${x}"', 'value="$(eval 1 + 1) ${x}"'),
    ],
)  # fmt: skip
def test_substitution_args_are_expanded_as_far_as_they_are_given(text: str, expanded: str) -> None:
    assert expand_substitution_args(text, ARGUMENTS, ENVIRONMENT) == expanded


def test_file_without_xacro_has_its_substitution_args_expanded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENSIM_TEST_TILT", "0 0 1")
    text = '<robot name="$(arg n)"><a rpy="$(optenv ZENSIM_TEST_TILT 0 0 0)"/></robot>'
    file = tmp_path / "r.urdf"
    file.write_text(text)

    found = read_description_file(file, {"n": "x"}, SearchPaths()).text

    assert found == '<robot name="x"><a rpy="0 0 1"/></robot>'
    assert read_description_stream(BytesIO(text.encode()), {"n": "x"}, SearchPaths()).text == found


SDF = '<sdf version="1.6"><model name="m"/></sdf>'


def make_model_folder(folder: Path, config: str = "", **files: str) -> SearchPaths:
    model = folder / "crate"
    model.mkdir()
    if config:
        (model / "model.config").write_text(config)
    for name, text in files.items():
        (model / f"{name}.sdf").write_text(text)
    return collect_search_paths([folder], {})


def test_stream_is_expanded_if_it_is_xacro() -> None:
    text = (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="n" '
        'default="1"/><link name="l$(arg n)"/></robot>'
    )

    found = read_description_stream(
        BytesIO(text.encode()), {"n": "7"}, collect_search_paths((), {})
    )

    assert '<link name="l7"/>' in found.text
    assert found.path is None


def test_long_stream_is_refused() -> None:
    with pytest.raises(ServiceError, match=r"xml.size: "):
        read_description_stream(
            BytesIO(b" " * (MAX_TEXT_BYTES + 9)), {}, collect_search_paths((), {})
        )


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_file_is_read_in_every_unicode_encoding(tmp_path: Path, encoding: str) -> None:
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
def test_file_is_read_in_its_declared_latin_encoding(
    tmp_path: Path, head: str, encoding: str
) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(f'{head}<robot name="räder"/>'.encode(encoding))

    assert read_description_file(file, {}, SearchPaths()).text == f'{head}<robot name="räder"/>'


def test_invalid_bytes_in_comments_are_ignored(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(b'<!-- 30\xb0 --><robot name="r"/>')

    assert (
        read_description_file(file, {}, SearchPaths()).text == '<!-- 30\ufffd --><robot name="r"/>'
    )


def test_large_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    with file.open("wb") as large:
        large.truncate(MAX_TEXT_BYTES + 1)

    with pytest.raises(ServiceError, match=r"xml.size: .*2097152"):
        read_description_file(file, {}, SearchPaths())


def test_name_is_a_built_in_model_or_sent_to_the_server() -> None:
    shipped, other = (read_model_argument(word, {}, SearchPaths()) for word in ("box_bot", "tank"))

    assert '<robot name="box_bot">' in shipped.text
    assert other == RobotDescription(uri="tank")


def test_database_uses_the_last_file_in_model_config(tmp_path: Path) -> None:
    config = '<model><name>c</name><sdf version="1.4">old.sdf</sdf><sdf>new.sdf</sdf></model>'
    paths = make_model_folder(tmp_path, config, old="<sdf/>", new=SDF)

    assert find_model_by_name("crate", {}, paths).text == SDF


def test_a_folder_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        read_model_argument(str(tmp_path), {}, SearchPaths())


def test_an_empty_file_is_refused_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "empty.urdf").touch()

    with pytest.raises(ServiceError, match=r"resource\.empty: .*empty\.urdf"):
        read_model_argument(str(tmp_path / "empty.urdf"), {}, SearchPaths())


def test_database_defaults_to_model_sdf(tmp_path: Path) -> None:
    assert find_model_by_name("crate", {}, make_model_folder(tmp_path, model=SDF)).text == SDF


def test_database_does_not_read_outside_the_model_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.sdf").write_text(SDF)
    paths = make_model_folder(tmp_path, "<sdf>../secret.sdf</sdf>")

    with pytest.raises(FileNotFoundError, match="model"):
        find_model_by_name("crate", {}, paths)


@pytest.mark.parametrize("name", ["nothing", "../crate", "", ".."])
def test_database_refuses_an_unknown_model(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileNotFoundError, match="model"):
        find_model_by_name(name, {}, make_model_folder(tmp_path, model=SDF))


@pytest.mark.parametrize("format_", Format)
def test_topic_is_decoded_in_each_format(format_: Format) -> None:
    bus = MemoryBus()
    bus.pumps.append(lambda: None)
    subscribe = bus.subscribe

    def subscribe_and_put(key: str, depth: int = 1) -> object:
        subscription = subscribe(key, depth)
        bus.put_message(key, String("<robot/>"), format_)
        return subscription

    bus.subscribe = subscribe_and_put  # type: ignore[method-assign,assignment]

    assert receive_description(cast("Bus", bus), "/a/b", 1.0).text == "<robot/>"


def test_topic_without_messages_has_a_timeout() -> None:
    with pytest.raises(TimeoutError, match="a/b"):
        receive_description(cast("Bus", MemoryBus()), "a/b", 0.01)


@pytest.mark.parametrize("key", ["", "/", "a//b", "a/*", "a b", "a/", "$x", "a?b", "a#b"])
def test_invalid_topic_is_refused(key: str) -> None:
    with pytest.raises(ValueError, match="-topic"):
        receive_description(cast("Bus", MemoryBus()), key, 0.01)


def test_package_uris_of_meshes_become_model_uris() -> None:
    text = '<robot a="package://a"><mesh scale="1" filename="package://p/a.stl"/></robot>'

    changed = to_model_uris(RobotDescription(text)).text

    assert changed == text.replace('filename="package://p', 'filename="model://p')


def test_undecodable_text_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(b"<robot name='\xff'/>")

    with pytest.raises(DescriptionError, match="byte 13"):
        read_description_file(file, {}, SearchPaths())


def test_package_that_is_not_well_formed_hides_no_other(tmp_path: Path) -> None:
    (make_package(tmp_path / "ws" / "deep", "parts") / "urdf" / "part.xacro").write_text(PART)
    (make_package(tmp_path / "ws", "broken") / "package.xml").write_text("<package><name>x</")
    file = make_xacro(make_package(tmp_path, "mine") / "urdf", INCLUDE)

    paths = collect_search_paths([tmp_path / "ws"], {})

    assert "<link" in read_description_file(file, {}, paths).text


def expand(file: Path, arguments: dict[str, str], *roots: Path) -> str:
    return expand_xacro(file.read_text(), file, arguments, collect_search_paths(roots, {}))


def test_xacro_names_a_property_without_its_prefix(tmp_path: Path) -> None:
    (tmp_path / "common.xacro").write_text('<robot><property name="M_PI" value="3.14"/></robot>')
    include = '<xacro:include filename="common.xacro"/>'
    file = make_xacro(tmp_path, f'{HEAD}{include}<link name="${{M_PI}}"/></robot>')

    with pytest.raises(DescriptionError, match=r"common\.xacro sets 'M_PI'.*<xacro:property>"):
        expand(file, {})


def test_xacro_prefers_a_package_to_a_folder_of_its_name(tmp_path: Path) -> None:
    package = make_package(tmp_path / "parts", "parts").rename(tmp_path / "parts" / "parts_gazebo")
    (package / "urdf" / "part.xacro").write_text(PART)
    file = make_xacro(tmp_path, INCLUDE)

    for root in (tmp_path, tmp_path / "parts"):
        assert "found" in expand(file, {}, root)


def test_xacro_names_the_package_folders_when_a_package_is_missing(tmp_path: Path) -> None:
    file = make_xacro(tmp_path, INCLUDE)

    with pytest.raises(
        DescriptionError, match=r"--package-path.*package_paths.*ROS_PACKAGE_PATH"
    ) as refusal:
        expand(file, {})
    assert str(refusal.value).count("Package not found") == 1
    assert "<class" not in str(refusal.value)


def test_xacro_names_the_option_of_an_argument_that_is_missing(tmp_path: Path) -> None:
    text = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="$(arg who)"/>'

    with pytest.raises(DescriptionError, match=r"--xacro-arg who:="):
        expand(make_xacro(tmp_path, text), {})


def test_xacro_argument_that_nothing_reads_is_refused(tmp_path: Path) -> None:
    file = make_xacro(tmp_path, HEAD + '<xacro:arg name="camera" default="0"/></robot>')

    assert expand(file, {"camera": "1"})
    with pytest.raises(DescriptionError, match=r"'camra'.*'camera'"):
        expand(file, {"camra": "1"})
