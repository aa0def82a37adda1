"""Each slug that a refusal can have is in docs/refusals.md, and each one there can be had."""

from tests.contract.slugs import listed_slugs, raised_slugs


def test_document_lists_every_slug_that_the_code_raises() -> None:
    assert raised_slugs() - set(listed_slugs()) == set()


def test_document_lists_no_slug_that_nothing_raises() -> None:
    assert set(listed_slugs()) - raised_slugs() == set()


def test_document_lists_each_slug_once() -> None:
    listed = listed_slugs()

    assert sorted(set(listed)) == sorted(listed)
