"""The JSON Schema and the reference of scenario files against the types of the format."""

import pytest
import yaml

from tests.contract.repository import ROOT
from tests.contract.schema_validators import jsonschema
from tests.scenario.test_scenario_reader import BROKEN, FULL
from zensim.scenario.scenario_reader import SHIPPED
from zensim.scenario.scenario_schema import (
    SCHEMA_FILE,
    format_schema,
    make_reference,
    make_schema,
    replace_reference,
)

PAGE = ROOT / "docs" / "scenarios.md"
FOUND_BY_THE_SCHEMA = (
    *("unknown_key", "missing_version", "wrong_unit", "unknown_unit", "unknown_choice"),
    *("text_for_number", "negative_seed", "map_for_list", "missing_model", "unknown_behaviour"),
)


def validate(text: str) -> None:
    jsonschema().Draft202012Validator(make_schema()).validate(yaml.safe_load(text))


def test_shipped_schema_matches_the_types() -> None:
    assert SCHEMA_FILE.read_text(encoding="utf-8") == format_schema(), (
        "run 'python -m zensim.scenario.scenario_schema'"
    )


def test_page_has_the_reference_of_the_types() -> None:
    page = PAGE.read_text(encoding="utf-8")

    assert page == replace_reference(page), "run 'python -m zensim.scenario.scenario_schema'"


def test_schema_is_valid() -> None:
    jsonschema().Draft202012Validator.check_schema(make_schema())


def test_schema_accepts_a_full_file() -> None:
    validate(FULL)


@pytest.mark.parametrize("file", sorted(SHIPPED.glob("*.yaml")), ids=lambda file: file.name)
def test_shipped_scenario_validates(file: object) -> None:
    validate(file.read_text(encoding="utf-8"))  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", FOUND_BY_THE_SCHEMA)
def test_schema_refuses_a_broken_file(name: str) -> None:
    text, _ = BROKEN[name]

    with pytest.raises(jsonschema().ValidationError):
        validate(text)


def test_reference_describes_every_key() -> None:
    rows = [line for line in make_reference().splitlines() if line.startswith("| `")]

    assert len(rows) > 100
    assert [row for row in rows if row.endswith("|  |")] == []
