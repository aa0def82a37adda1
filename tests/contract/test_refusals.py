"""docs/refusals.md lists exactly the slugs that the code raises."""

from tests.contract.slugs import listed_slugs, raised_slugs


def test_document_lists_every_slug_that_the_code_raises() -> None:
    assert raised_slugs() - set(listed_slugs()) == set()


def test_document_lists_no_unused_slug() -> None:
    assert set(listed_slugs()) - raised_slugs() == set()


def test_document_lists_each_slug_once() -> None:
    listed = listed_slugs()

    assert sorted(set(listed)) == sorted(listed)
