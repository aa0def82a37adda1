"""Texts that differ in names alone are parsed twice, and then copied."""

from collections.abc import Callable

import msgspec
import pytest

from tests.fakes import ManualClock
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.parser_process.parser_protocol import ParseRequest
from zensim.sim_server.parser_process.parser_worker import parse_request
from zensim.sim_server.parser_process.renamed_texts import (
    MAX_FORMS,
    MAX_PARSING_S,
    MAX_TEXT_CHARACTERS,
    ParsedText,
    RenamedTexts,
    split_names,
)
from zensim.spawner.spawn.description_xml import add_namespace

BOX_BOT = read_builtin_model("box_bot")


class CountingParser:
    """Parses, and keeps the texts."""

    def __init__(self, parse: Callable[[ParseRequest], ParsedText] | None = None) -> None:
        self.texts: list[str] = []
        self._parse = parse or (lambda request: parse_request(request, {}))

    def parse(self, request: ParseRequest) -> ParsedText:
        self.texts.append(request.text)
        return self._parse(request)


def parse_and_check(texts: RenamedTexts, request: ParseRequest) -> ParsedText:
    """Parse as the parser process does, which replies in between."""
    parsed = texts.parse(request)
    texts.check()
    return parsed


def test_second_text_is_parsed_once_before_its_reply() -> None:
    parser = CountingParser()
    texts = RenamedTexts(parser.parse)
    parse_and_check(texts, ParseRequest(0, a_text("r0")))

    texts.parse(ParseRequest(1, a_text("r1")))
    before_the_reply = len(parser.texts)
    texts.check()

    assert (before_the_reply, len(parser.texts)) == (2, 3)


def a_text(name: str) -> str:
    """Make the text that `zensim spawn` sends for a name."""
    return add_namespace(BOX_BOT, name)


def test_third_text_of_a_form_is_not_parsed() -> None:
    parser = CountingParser()
    texts = RenamedTexts(parser.parse)
    for number in range(2):
        parse_and_check(texts, ParseRequest(number, a_text(f"r{number}")))
    count = len(parser.texts)

    result, meshes = parse_and_check(texts, ParseRequest(9, a_text("far_away")))

    assert len(parser.texts) == count
    assert (result.number, meshes) == (9, {})
    expected, _ = parse_request(ParseRequest(9, a_text("far_away")), {})
    assert result == expected


@pytest.mark.parametrize("name", ["a", "base_link", "x" * 64, "box_bot"])
def test_copies_equal_parsed_models(name: str) -> None:
    texts = RenamedTexts(CountingParser().parse)
    for number in range(2):
        parse_and_check(texts, ParseRequest(number, a_text(f"r{number}")))

    result, _ = parse_and_check(texts, ParseRequest(3, a_text(name)))

    assert result == parse_request(ParseRequest(3, a_text(name)), {})[0]


def test_name_of_the_root_element_is_replaced() -> None:
    texts = RenamedTexts(CountingParser().parse)
    for number in range(2):
        parse_and_check(
            texts, ParseRequest(number, BOX_BOT.replace('"box_bot"', f'"bot{number}"', 1))
        )

    result, _ = parse_and_check(texts, ParseRequest(3, BOX_BOT.replace('"box_bot"', '"other"', 1)))

    assert result.model is not None
    assert result.model.name == "other"


def test_text_with_other_options_is_parsed() -> None:
    parser = CountingParser()
    texts = RenamedTexts(parser.parse)
    for number in range(2):
        parse_and_check(texts, ParseRequest(number, a_text(f"r{number}")))

    result, _ = parse_and_check(texts, ParseRequest(3, a_text("r3"), drive=DriveOrder(kind="none")))

    assert result.model is not None
    assert result.model.drive is None
    assert parser.texts[-1] == a_text("r3")


def test_text_is_parsed_where_a_name_has_another_effect() -> None:
    def parse_by_name(request: ParseRequest) -> ParsedText:
        is_double = "<namespace>/rr" in request.text
        drive = DriveOrder(kind="none") if is_double else DriveOrder()
        return parse_request(msgspec.structs.replace(request, drive=drive), {})

    parser = CountingParser(parse_by_name)
    texts = RenamedTexts(parser.parse)
    for number in range(8):
        parse_and_check(texts, ParseRequest(number, a_text("r" * (number + 1))))

    assert parser.texts[-1] == a_text("r" * 8)


def test_text_whose_meshes_are_made_is_parsed() -> None:
    parser = CountingParser(lambda request: (parse_request(request, {})[0], {"mesh": b""}))
    texts = RenamedTexts(parser.parse)

    found = [
        parse_and_check(texts, ParseRequest(number, a_text(f"r{number}"))) for number in range(4)
    ]

    assert [meshes for _, meshes in found] == [{"mesh": b""}] * 4


def test_refused_text_is_parsed_each_time() -> None:
    texts = RenamedTexts(CountingParser().parse)
    broken = [a_text(f"r{number}").replace("</robot>", "") for number in range(4)]

    results = [
        parse_and_check(texts, ParseRequest(number, text))[0] for number, text in enumerate(broken)
    ]

    assert {(one.model, one.slug) for one in results} == {(None, "xml.syntax")}


@pytest.mark.parametrize("name", ["world", "sim", "1st", "a-b", "true", "false"])
def test_invalid_and_reserved_names_are_not_replaced(name: str) -> None:
    text = f'<robot name="{name}"><namespace>{name}</namespace></robot>'

    assert split_names(text).form == text


def parse_four(texts: RenamedTexts, controllers: tuple[str, ...] = ()) -> None:
    for number in range(4):
        parse_and_check(texts, ParseRequest(number, a_text(f"r{number}"), controllers=controllers))


def test_text_with_large_controllers_is_not_kept() -> None:
    parser = CountingParser()

    parse_four(RenamedTexts(parser.parse), ("#" * MAX_TEXT_CHARACTERS,))

    assert parser.texts == [a_text(f"r{number}") for number in range(4)]


def test_text_that_takes_long_is_not_parsed_twice() -> None:
    clock = ManualClock()

    def parse(request: ParseRequest) -> ParsedText:
        clock.sleep(2 * MAX_PARSING_S)
        return parse_request(request, {})

    parser = CountingParser(parse)

    parse_four(RenamedTexts(parser.parse, clock))

    assert parser.texts == [a_text(f"r{number}") for number in range(4)]


def test_number_of_forms_is_limited() -> None:
    parser = CountingParser()
    texts = RenamedTexts(parser.parse)
    first = [a_text(f"r{number}") for number in range(4)]
    for number, text in enumerate(first[:2]):
        parse_and_check(texts, ParseRequest(number, text))
    for number in range(MAX_FORMS):
        parse_and_check(
            texts,
            ParseRequest(number, a_text("r0").replace("</robot>", f"<!--{number}--></robot>")),
        )
    before = len(parser.texts)

    parse_and_check(texts, ParseRequest(3, first[2]))
    parse_and_check(texts, ParseRequest(4, first[3]))

    assert parser.texts[before] == first[2]
