"""Strict parsing of XML and numbers, with limits."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.strict_parsing import (
    MAX_BYTES,
    MAX_DEPTH,
    MAX_TAGS,
    parse_xml,
    read_number,
    read_numbers,
)
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


BOMB = (
    '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    "<robot name='&b;'/>"
)


def test_parser_reads_a_document_when_it_is_plain() -> None:
    root = parse_xml('<robot name="r"><link name="a"/></robot>', root_tag="robot", slug="urdf")

    assert (root.get("name"), [child.tag for child in root]) == ("r", ["link"])


@pytest.mark.parametrize(
    "head",
    [
        "",
        "\ufeff",
        "\n  ",
        '<?xml version="1.0"?>\n',
        '<?xml version="1.0" encoding="UTF-16"?>',
        "<!-- <!DOCTYPE robot> -->",
        '<?xml version="0.0" ?>',
        '<!-- c -->\n<?pi?><?xml version="1.0"?>',
        "<?xml version='1.0'?><?pi <!DOCTYPE ?>\n<!-- c -->",
    ],
)
def test_parser_reads_a_document_when_it_has_a_harmless_head(head: str) -> None:
    root = parse_xml(f"{head}<robot>ä<!-- c --></robot>", root_tag="robot", slug="urdf")

    assert (root.text, len(root)) == ("ä", 0)


def test_parser_drops_a_default_namespace_when_the_root_has_one() -> None:
    text = '<robot xmlns="http://www.ros.org" xmlns:x="urn:x"><link/><x:link/></robot>'

    root = parse_xml(text, root_tag="robot", slug="urdf")

    assert [root.tag, *(child.tag for child in root)] == ["robot", "link", "{urn:x}link"]


def test_undeclared_prefix_is_part_of_the_name() -> None:
    root = parse_xml("<robot><a:b c:d='1'/></robot>", root_tag="robot", slug="urdf")

    assert [child.tag for child in root] == ["a:b"]


def test_comment_may_have_two_hyphens() -> None:
    text = "<!-- -- a -- -->\n<robot><!--\n--\n--><link/><a:b/></robot>"

    root = parse_xml(text, root_tag="robot", slug="urdf")

    assert [(child.tag, child.sourceline) for child in root] == [("link", 4), ("a:b", 4)]


def test_other_faults_are_refused_when_a_comment_has_two_hyphens() -> None:
    with pytest.raises(ModelError) as caught:
        parse_xml("<robot><!-- -- --></robt>", root_tag="robot", slug="urdf")

    assert caught.value.slug == "xml.syntax"


def test_other_faults_are_refused_when_a_prefix_is_undeclared() -> None:
    with pytest.raises(ModelError) as caught:
        parse_xml("<robot><a:b/></robt>", root_tag="robot", slug="urdf")

    assert caught.value.slug == "xml.syntax"


@pytest.mark.parametrize("head", ["", "<?xml version='1.0'?>\n", "<!-- c -->\n<?pi?> ", "\ufeff"])
def test_parser_refuses_a_doctype_when_it_comes_first_or_later(head: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse_xml(head + BOMB, root_tag="robot", slug="urdf")

    assert caught.value.slug == "xml.doctype"


@pytest.mark.parametrize(
    "text",
    ["<robot>", "<robot></link>", "no xml", "<!--", "<?xml", "<robot>&nbsp;</robot>", "<a\0/>"],
)
def test_parser_refuses_text_when_it_is_not_well_formed(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse_xml(text, root_tag="robot", slug="urdf")

    assert (caught.value.slug, caught.value.code) == ("xml.syntax", SpawnCode.RESOURCE_PARSE_ERROR)


def test_parser_refuses_text_when_it_has_a_lone_surrogate() -> None:
    with pytest.raises(ModelError, match="character 7") as caught:
        parse_xml("<robot>\ud800</robot>", root_tag="robot", slug="urdf")

    assert caught.value.slug == "xml.encoding"


@pytest.mark.parametrize("text", ["", "  \n", "\ufeff"])
def test_parser_refuses_text_when_it_is_empty(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse_xml(text, root_tag="robot", slug="urdf")

    assert (caught.value.slug, caught.value.code) == ("xml.empty", SpawnCode.NO_RESOURCE)


def test_parser_refuses_another_root_when_one_is_expected() -> None:
    with pytest.raises(ModelError, match=r"<sdf>.*<robot>") as caught:
        parse_xml("<sdf/>", root_tag="robot", slug="urdf")

    assert (caught.value.slug, caught.value.code) == ("urdf.root", SpawnCode.UNSUPPORTED_FORMAT)


@pytest.mark.parametrize(
    "text",
    [
        f"<robot>{' ' * MAX_BYTES}</robot>",
        f"<robot>{'<a/>' * MAX_TAGS}</robot>",
    ],
    ids=["bytes", "tags"],
)
def test_parser_refuses_text_when_it_is_huge(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse_xml(text, root_tag="robot", slug="urdf")

    assert caught.value.slug == "xml.size"


def test_parser_refuses_an_element_when_it_has_very_many_attributes() -> None:
    attributes = " ".join(f'a{i}=""' for i in range(100_000))

    with pytest.raises(ModelError, match=r"<a>.*100000") as caught:
        parse_xml(f"<robot><a {attributes}/></robot>", root_tag="robot", slug="urdf")

    assert caught.value.slug == "xml.size"


def test_parser_refuses_tags_when_they_nest_too_deep() -> None:
    deepest = f"<robot>{'<a>' * (MAX_DEPTH - 1)}{'</a>' * (MAX_DEPTH - 1)}</robot>"
    deeper = deepest.replace("<a>", "<a><a>", 1).replace("</a>", "</a></a>", 1)

    parse_xml(deepest, root_tag="robot", slug="urdf")

    with pytest.raises(ModelError) as caught:
        parse_xml(deeper, root_tag="robot", slug="urdf")
    assert caught.value.slug == "xml.depth"


def test_parser_refuses_tags_when_they_nest_beyond_what_xml_allows() -> None:
    text = "<robot>" + "<a>" * 5_000 + "</a>" * 5_000 + "</robot>"

    with pytest.raises(ModelError):
        parse_xml(text, root_tag="robot", slug="urdf")


def test_number_has_at_most_400_characters() -> None:
    assert read(f"0.{'0' * 397}1", 1) == (0.0,)
    with pytest.raises(ModelError):
        read(f"0.{'0' * 398}1", 1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lift: {}\nlevels:\n  L1: {}\n", "building_map_generator"),
        ("#VRML_SIM R2023b utf8\nWorldInfo {}\n", "Webots"),
        ("#usda 1.0\n", "USD"),
        ("zensim: 1\nrobots: []\n", "YAML"),
        ("nothing", "not well-formed"),
    ],
)
def test_format_that_is_not_read_is_named(text: str, words: str) -> None:
    with pytest.raises(ModelError, match=words) as refused:
        parse_xml(text, root_tag="sdf", slug="sdf")

    assert refused.value.slug == "xml.syntax"
