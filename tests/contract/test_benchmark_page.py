"""docs/benchmarks.md is what its results make of it."""

from benchmarks.__main__ import PAGE as RESULTS
from benchmarks.overview_page import PAGE, make_page
from tests.contract.repository import text_of


def test_page_is_made_from_the_results() -> None:
    assert text_of(PAGE) == make_page(text_of(RESULTS)), "python -m benchmarks.overview_page"
