"""Names and namespaces: free, taken or not valid."""

import pytest

from zensim.sim_server.errors import NameNotUnique, NameRefused, NamespaceRefused
from zensim.sim_server.world.spawn_request import MAX_RENAMES, check_free_namespace, find_free_name


def test_name_is_kept_when_it_is_free() -> None:
    assert find_free_name("r1", {"r2"}, allow_renaming=True) == "r1"


def test_name_is_refused_when_it_is_taken() -> None:
    with pytest.raises(NameNotUnique):
        find_free_name("r1", {"r1"}, allow_renaming=False)


def test_name_gets_the_first_free_number_when_renaming_is_allowed() -> None:
    taken = {"r", "r_1", "r_3"}

    assert find_free_name("r", taken, allow_renaming=True) == "r_2"


def test_name_stays_valid_with_any_number() -> None:
    longest = "a" * 64
    taken = {longest, *(f"{longest[:56]}_{i}" for i in range(1, MAX_RENAMES - 1))}

    renamed = find_free_name(longest, taken, allow_renaming=True)

    assert renamed == f"{longest[:56]}_{MAX_RENAMES - 1}"
    assert len(renamed) <= 64


@pytest.mark.parametrize("name", ["", "1r", "r 1", "r/1", "é", "a" * 65])
@pytest.mark.parametrize("allow_renaming", [True, False])
def test_name_is_refused_when_it_is_not_valid(name: str, *, allow_renaming: bool) -> None:
    with pytest.raises(NameRefused):
        find_free_name(name, set(), allow_renaming=allow_renaming)


@pytest.mark.parametrize(("given", "bare"), [("r1", "r1"), ("/r1", "r1"), ("/team/r1", "team/r1")])
def test_namespace_is_returned_without_a_leading_slash(given: str, bare: str) -> None:
    assert check_free_namespace(given, {"r2": "r2"}) == bare


@pytest.mark.parametrize("namespace", ["r1", "/r1"])
def test_namespace_is_refused_when_it_is_taken(namespace: str) -> None:
    with pytest.raises(NamespaceRefused):
        check_free_namespace(namespace, {"r1": "box"})


@pytest.mark.parametrize("namespace", ["", "/", "a//b", "a b", "sim", "/world/r", "a/" * 8 + "a"])
def test_namespace_is_refused_when_it_is_not_valid(namespace: str) -> None:
    with pytest.raises(NamespaceRefused):
        check_free_namespace(namespace, {})
