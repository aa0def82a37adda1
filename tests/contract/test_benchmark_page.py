"""docs/benchmarks.md is what its results make of it."""

from benchmarks.overview_page import PAGE, RESULTS, make_page
from tests.contract.repository import text_of


def test_page_is_made_from_the_results() -> None:
    assert text_of(PAGE) == make_page(text_of(RESULTS)), "python -m benchmarks.overview_page"
