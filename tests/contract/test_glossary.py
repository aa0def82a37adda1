"""The glossary is short enough to be read."""

import re

from tests.contract.repository import ROOT, text_of

MOST_TERMS = 80
ROW = re.compile(r"^\| (?!word |---)", re.MULTILINE)


def test_glossary_has_few_terms() -> None:
    assert 0 < len(ROW.findall(text_of(ROOT / "docs" / "glossary.md"))) <= MOST_TERMS
