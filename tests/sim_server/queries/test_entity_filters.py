"""Filters of entities, and time limits of expensive ones."""

import re

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.models import a_box, on_ground
from tests.sim_server.fakes import WallTime, a_spawn, a_world, handle_request, make_parts
from zensim.proto.messages import entity_messages
from zensim.proto.messages.entity_messages import (
    Bounds,
    BoundsType,
    Category,
    EntityCategory,
    EntityFilters,
    EntityInfo,
    FilterMode,
    TagsFilter,
)
from zensim.proto.messages.standard_messages import Vector3
from zensim.sim_server.errors import SimError
from zensim.sim_server.queries.entity_filters import PatternRefused, PosixPattern, SearchTooLong
from zensim.sim_server.queries.sliced_work import MAX_WORK_S, SLICE_NS
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.world.simulated_world import SimulatedWorld


def an_info(category: Category, *tags: str) -> EntityInfo:
    return EntityInfo(EntityCategory(category), "", tags)


def a_tagged_world() -> SimulatedWorld:
    world = a_world("r0", "r1", "r2")
    world.set_info("r0", an_info(Category.ROBOT, "fast", "red"))
    world.set_info("r1", an_info(Category.HUMAN, "red"))
    world.spawn(a_spawn("crate", model=a_box(), base=on_ground(10.0)))
    return world


def filter_names(parts: ServerParts, filters: EntityFilters) -> tuple[str, ...]:
    response = handle_request(parts, entity_messages.GetEntitiesRequest(filters))
    if isinstance(response, DeferredResponse):
        while not response.is_ready():
            pass
        response = response.outcome()
    assert isinstance(response, entity_messages.GetEntitiesResponse)
    return response.entities


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Bounds:
    return Bounds(BoundsType.BOX, (Vector3(*high), Vector3(*low)))


def tags(mode: FilterMode, *names: str) -> EntityFilters:
    return EntityFilters(tags=TagsFilter(names, mode))


def categories(*kinds: Category) -> EntityFilters:
    return EntityFilters(categories=tuple(EntityCategory(kind) for kind in kinds))


@pytest.mark.parametrize(
    ("filters", "names"),
    [
        (EntityFilters(), ("r0", "r1", "r2", "crate")),
        (EntityFilters("[12]$"), ("r1", "r2")),
        (categories(Category.ROBOT), ("r0", "r2")),
        (categories(Category.HUMAN, Category.OBJECT), ("r1", "crate")),
        (tags(FilterMode.ANY, "fast", "red"), ("r0", "r1")),
        (tags(FilterMode.ALL, "fast", "red"), ("r0",)),
        (tags(FilterMode.ALL), ("r0", "r1", "r2", "crate")),
        (EntityFilters(bounds=box((-1, -1, -1), (1.3, 1, 1))), ("r0", "r1")),
        (EntityFilters(bounds=box((1.3, 1, 1), (-1, -1, -1))), ("r0", "r1")),
        (EntityFilters(bounds=box((10.05, 0, 0), (11, 1, 1))), ("crate",)),
        (EntityFilters(bounds=box((10.11, 0, 0), (11, 1, 1))), ()),
        (
            EntityFilters(bounds=Bounds(BoundsType.SPHERE, (Vector3(0.0, 0.0, 0.0), Vector3(1.5)))),
            ("r0", "r1"),
        ),
        (
            EntityFilters(
                bounds=Bounds(
                    BoundsType.CONVEX_HULL,
                    (Vector3(9, -1, 0.05), Vector3(11, -1, 0.05), Vector3(10, 2, 0.05)),
                )
            ),
            ("crate",),
        ),
        (
            EntityFilters(
                "^r", (EntityCategory(Category.ROBOT),), bounds=box((0.5, -1, -1), (20, 1, 1))
            ),
            ("r2",),
        ),
    ],
)
def test_entities_that_pass_all_filters_are_filter_names(
    filters: EntityFilters, names: tuple[str, ...]
) -> None:
    assert filter_names(make_parts(a_tagged_world()), filters) == names


@pytest.mark.parametrize(
    ("filters", "code", "slug"),
    [
        (EntityFilters("("), 4, "filter.pattern"),
        (EntityFilters(tags=TagsFilter(("a",), 7)), 4, "filter.tags"),
        (EntityFilters(tags=TagsFilter(tuple(f"t{i}" for i in range(65)))), 4, "filter.tags"),
        (EntityFilters(bounds=Bounds(9)), 0, "filter.bounds"),
        (EntityFilters(bounds=Bounds(BoundsType.BOX)), 4, "filter.bounds"),
        (EntityFilters(bounds=box((float("nan"), 0, 0), (1, 1, 1))), 4, "filter.bounds"),
        (
            EntityFilters(bounds=Bounds(BoundsType.SPHERE, (Vector3(), Vector3(-1.0)))),
            4,
            "filter.bounds",
        ),
        (
            EntityFilters(
                bounds=Bounds(
                    BoundsType.CONVEX_HULL, tuple(Vector3(x, 2.0 * x, 0) for x in (0.0, 1.0, 3.0))
                )
            ),
            4,
            "filter.bounds",
        ),
    ],
)
def test_filters_that_are_not_valid_are_refused(
    filters: EntityFilters, code: int, slug: str
) -> None:
    with pytest.raises(SimError) as error:
        filter_names(make_parts(a_tagged_world()), filters)

    assert (error.value.code, error.value.slug) == (code, slug)


LARGE = "r|(a?){500}a{500}"
"""Searched in one name in each turn."""


class SlowWall(WallTime):
    """A clock that advances at each reading."""

    pace_ns = SLICE_NS

    def now_ns(self) -> int:
        self.ns += self.pace_ns
        return self.ns


def test_long_search_takes_several_turns_and_filters_the_entities_of_the_first() -> None:
    world = a_tagged_world()
    response = handle_request(
        make_parts(world, SlowWall()), entity_messages.GetEntitiesRequest(EntityFilters(LARGE))
    )
    assert isinstance(response, DeferredResponse)
    world.delete("r0")

    turns = 1
    while not response.is_ready():
        turns += 1

    assert turns >= 2
    assert msgspec.to_builtins(response.outcome())["entities"] == ("r0", "r1", "r2", "crate")


def test_search_that_takes_too_long_is_refused() -> None:
    names = [f"r{i}" for i in range(200)]
    parts = make_parts(a_world(*names), wall := SlowWall())
    response = handle_request(parts, entity_messages.GetEntitiesRequest(EntityFilters("r")))
    assert isinstance(response, DeferredResponse)

    wall.pace_ns = 2 * int(MAX_WORK_S * 1e9)
    while not response.is_ready():
        pass

    with pytest.raises(SearchTooLong):
        response.outcome()


NAMES = ("r1", "r10", "robot_2", "Box", "shelf_a1")


def search(pattern: str, names: tuple[str, ...] = NAMES) -> list[str]:
    return [name for some in PosixPattern(pattern).search(names) for name in some]


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("r1", ["r1", "r10"]),
        ("^r1$", ["r1"]),
        ("^r", ["r1", "r10", "robot_2"]),
        ("[[:upper:]]", ["Box"]),
        ("1$|^B", ["r1", "Box", "shelf_a1"]),
        ("(o|e){1}", ["robot_2", "Box", "shelf_a1"]),
        ("[^a-z0-9_]", ["Box"]),
        ("", list(NAMES)),
        ("x{2}", []),
        (".", list(NAMES)),
    ],
)
def test_pattern_is_found_anywhere_in_a_name(pattern: str, names: list[str]) -> None:
    assert search(pattern) == names


@pytest.mark.parametrize(
    "pattern",
    ["(", "a)(b", "a**(", "[z-a]", "a{99999}", r"\d", r"(a)\1", "(?i)a", "[[:no:]]", "\ud800"],
)
def test_invalid_pattern_is_refused_in_one_line(pattern: str) -> None:
    with pytest.raises(PatternRefused) as error:
        PosixPattern(pattern)

    assert "\n" not in str(error.value)


def test_long_pattern_is_refused() -> None:
    with pytest.raises(PatternRefused):
        PosixPattern("a" * 2000)


@pytest.mark.parametrize(
    ("pattern", "min_turns", "max_turns"),
    [("^r[0-9]+$", 1, 4), ("^(a+)+$", 1, 4), ("(a?){500}a{500}", 50, 300)],
    ids=["plain", "nested", "large"],
)
def test_larger_patterns_are_searched_in_fewer_names_per_turn(
    pattern: str, min_turns: int, max_turns: int
) -> None:
    names = tuple("a" * 60 + f"{i:04}" for i in range(300))

    matches_by_turn = list(PosixPattern(pattern).search(names))

    assert min_turns <= len(matches_by_turn) <= max_turns
    assert not any(matches_by_turn)


@settings(max_examples=25)
@given(
    st.from_regex(r"\A[ab]?(\[ab\]|a\*|b\+|\(a\|b\)|\.)[ab]?\Z"),
    st.lists(st.from_regex(r"\A[abc]{1,6}\Z"), max_size=20, unique=True),
)
def test_pattern_matches_the_same_names_as_python_re(pattern: str, names: list[str]) -> None:
    assert search(pattern, tuple(names)) == [name for name in names if re.search(pattern, name)]
