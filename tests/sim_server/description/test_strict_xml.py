"""Strict parsing of XML, with limits."""

import pytest

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.strict_xml import MAX_BYTES, MAX_DEPTH, MAX_TAGS, parse_xml
from zensim.sim_server.errors import ModelError

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
    [f"<robot>{' ' * MAX_BYTES}</robot>", f"<robot>{'<a/>' * MAX_TAGS}</robot>"],
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
