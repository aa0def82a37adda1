"""XML that attacks its parser: entities, includes, depth, size, malformed text."""

from collections.abc import Iterator

from tests.hostile.case import Case, link, robot

GOOD = robot(link("a"))
MIB = 1 << 20


def documents() -> Iterator[Case]:
    """Make documents that are refused by the XML parser."""
    yield from _doctypes()
    yield from _broken()
    yield from _large()
    yield from _foreign()


def _doctypes() -> Iterator[Case]:
    file = '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
    net = '<!DOCTYPE robot [<!ENTITY x SYSTEM "http://127.0.0.1:9/x">]>'
    remote = '<!DOCTYPE robot [<!ENTITY % d SYSTEM "http://127.0.0.1:9/d.dtd"> %d;]>'
    laughs = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
    heads = {
        "entity_of_a_file": file,
        "entity_of_the_net": net,
        "entity_of_a_parameter": remote,
        "billion_laughs": f'<!DOCTYPE robot [<!ENTITY l0 "ha">{laughs}]>',
        "quadratic_blowup": f'<!DOCTYPE robot [<!ENTITY x "{"a" * 50_000}">]>',
        "entity_that_holds_itself": '<!DOCTYPE robot [<!ENTITY x "&x;">]>',
        "external_dtd": '<!DOCTYPE robot SYSTEM "file:///dev/random">',
        "public_dtd": '<!DOCTYPE robot PUBLIC "-//W3C//DTD XHTML 1.0//EN" "http://127.0.0.1/d">',
        "empty_doctype": "<!DOCTYPE robot>",
        "doctype_after_comment": "<!-- harmless --><!DOCTYPE robot>",
        "doctype_after_instruction": '<?xml version="1.0"?><?a b?>\n<!DOCTYPE robot []>',
        "unfinished_doctype": "<!DOCTYPE robot [",
        "default_attribute": '<!DOCTYPE robot [<!ATTLIST link name CDATA "x">]>',
        "notation": '<!DOCTYPE robot [<!NOTATION n SYSTEM "x">]>',
    }
    for name, head in heads.items():
        yield Case(f"doctype_{name}", f"{head}\n{robot(link('&x;'))}", "xml.doctype")


def _broken() -> Iterator[Case]:
    texts = {
        "cut_in_a_tag": GOOD[: len(GOOD) // 2],
        "cut_before_the_end": GOOD[:-2],
        "two_roots": GOOD * 2,
        "wrong_end": "<robot></robto>",
        "crossed_tags": '<robot name="r"><link name="a"><visual></link></visual></robot>',
        "unknown_entity": robot("&nbsp;"),
        "bare_ampersand": robot(link("a & b")),
        "same_attribute_twice": '<robot name="a" name="b"/>',
        "unquoted_attribute": "<robot name=r/>",
        "less_than_in_attribute": '<robot name="<"/>',
        "nul": robot(link("a\0b")),
        "control_character": robot(link("a\x01")),
        "escaped_nul": robot(link("&#0;")),
        "escaped_surrogate": robot(link("&#xD800;")),
        "escaped_beyond_unicode": robot(link("&#x110000;")),
        "no_xml": "name: robot",
        "json": '{"robot": {}}',
        "only_a_comment": "<!-- robot -->",
        "only_a_declaration": '<?xml version="1.0"?>',
        "unfinished_comment": "<!-- " + GOOD,
        "unfinished_cdata": "<robot><![CDATA[ ]]</robot>",
        "dashes_in_unfinished_comments": "<robot>" + "<!-- -" * 30_000,
        "dashes_in_unfinished_comment": "<robot><!-- a -- b --",
        "dashes_in_comment_and_wrong_end": "<robot><!-- a -- b --></robto>",
        "declaration_inside": robot('<?xml version="1.0"?>'),
        "utf16_as_latin1": GOOD.encode("utf-16").decode("latin-1"),
        "gzip": "\x1f\ufffd\x08\x00" * 100,
        "elf": "\x7fELF" + "\x00" * 100,
        "png": "\ufffdPNG\r\n\x1a\n",
        "begins_with_nul": "\0" + GOOD,
        "xml_thrice": '<?xml version="1.0"?>' * 3 + GOOD,
        "name_begins_with_a_digit": robot("<1link/>"),
    }
    for name, text in texts.items():
        yield Case(f"broken_{name}", text, "xml.syntax")
    for name, text in {"nothing": "", "spaces": " \n\t ", "mark_only": "\ufeff"}.items():
        yield Case(f"empty_{name}", text, "xml.empty")
    for name, text in {"high": "\ud800", "low": "\udfff", "swapped": "\udc00\ud800"}.items():
        yield Case(f"surrogate_{name}", robot(link(text)), "xml.encoding")


def _large() -> Iterator[Case]:
    flood = " ".join(f'a{i}="1"' for i in range(2000))
    texts = {
        "comment_of_8_mib": robot(f"<!--{'x' * (8 * MIB)}-->"),
        "name_of_9_mib": robot(link("n" * (9 * MIB))),
        "text_of_8_mib": robot("x" * (8 * MIB + 1)),
        "spaces_of_8_mib": robot(" " * (8 * MIB)),
        "wide_characters": robot("<!--" + chr(0x1F916) * (2 * MIB) + "-->"),
        "tags": robot("<a/>" * 410_000),
        "end_tags": robot("<a></a>" * 210_000),
        "attributes": f"<robot {flood}/>",
        "attributes_on_a_link": robot(f"<link {flood}/>"),
        "namespaces": robot("<link " + " ".join(f'p{i}:x="1"' for i in range(100)) + "/>"),
    }
    for name, text in texts.items():
        yield Case(f"large_{name}", text, "xml.size")
    for depth in (65, 200):
        yield Case(f"depth_{depth}", "<robot>" * depth + "</robot>" * depth, "xml.depth")
    deep = "<a>" * 100 + "</a>" * 100
    yield Case("depth_in_a_gazebo_block", robot(f"<gazebo>{deep}</gazebo>"), "xml.depth")
    # The parser's own limit applies first.
    yield Case("depth_10000", "<robot>" * 10_000 + "</robot>" * 10_000, "xml.syntax")


def _foreign() -> Iterator[Case]:
    texts = {
        "sdf": '<sdf version="1.6"><model name="m"/></sdf>',
        "html": "<html><body/></html>",
        "svg": '<svg xmlns="http://www.w3.org/2000/svg"/>',
        "upper_case": "<ROBOT name='r'/>",
        "link": link("a"),
        "colon_only": "<:/>",
        "robot_of_another_prefix": '<x:robot xmlns:x="urn:x" name="r"/>'.replace("robot", "rob"),
        "mujoco": "<mujoco/>",
    }
    for name, text in texts.items():
        yield Case(f"root_{name}", text, "urdf.root")
    xacro = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    left = {
        "include": '<xacro:include filename="/etc/passwd"/>',
        "macro": '<xacro:macro name="m" params="a"/>',
        "property": '<xacro:property name="p" value="1"/>',
        "python": link("${__import__('os').system('true')}"),
        "substitution": link("$(find r)"),
        "environment": link("$(env HOME)"),
    }
    for name, inside in left.items():
        yield Case(f"xacro_{name}", f'<robot name="r" {xacro}>{inside}</robot>', "urdf.xacro")
