"""docs/services.md has a row for each service, with a valid example request."""

import json
import re

import msgspec
import pytest

from tests.contract.repository import ROOT, text_of
from zensim.proto.codec.message_codec import Format, decode
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.services.service_registry import SERVICE_TABLE

ROW = re.compile(r"^\| `(\w+)` \|.*$", re.MULTILINE)
EXAMPLE = re.compile(r"\| `(\{.*\})` \|$")
PAGE = ROOT / "docs" / "services.md"


def page_rows() -> dict[str, str]:
    return {row[1]: row[0] for row in ROW.finditer(text_of(PAGE))}


def row_without_example(name: str) -> str:
    """Format the row of a service without its last column."""
    service = SERVICES[name]
    (features,) = (one.features for one in SERVICE_TABLE if one.service.name == name)
    codes = ", ".join(f"{code.name} {code.value}" for code in service.codes)
    messages = f"{service.request.__name__} → {service.response.__name__}"
    return f"| `{name}` | {messages} | {codes} | {', '.join(f.name for f in features)} |"


def test_page_has_exactly_one_row_per_service() -> None:
    assert set(page_rows()) == set(SERVICES)


@pytest.mark.parametrize("name", SERVICES)
def test_row_matches_the_code(name: str) -> None:
    assert page_rows()[name].startswith(row_without_example(name))


@pytest.mark.parametrize("name", SERVICES)
def test_example_is_a_valid_request(name: str) -> None:
    found = EXAMPLE.search(page_rows()[name])
    assert found, "the last column holds an example in JSON"

    decode(SERVICES[name].request, found[1].encode(), Format.JSON.value)

    assert unknown_fields(SERVICES[name].request, json.loads(found[1])) == []


def unknown_fields(kind: type[msgspec.Struct], given: dict[str, object]) -> list[str]:
    return [field for field in given if field not in kind.__struct_fields__]
