"""Filters: which entities pass, and that a hostile filter holds nobody up."""

import msgspec
import pytest

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
from zensim.sim_server.queries.entity_filters import MAX_SEARCH_NS, SEARCH_SLICE_NS, SearchTooLong
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.world.simulated_world import World


def an_info(category: Category, *tags: str) -> EntityInfo:
    return EntityInfo(EntityCategory(category), "", tags)


def a_tagged_world() -> World:
    world = a_world("r0", "r1", "r2")
    world.set_info("r0", an_info(Category.ROBOT, "fast", "red"))
    world.set_info("r1", an_info(Category.HUMAN, "red"))
    world.spawn(a_spawn("crate", model=a_box(), base=on_ground(10.0)))
    return world


def found(parts: ServerParts, filters: EntityFilters) -> tuple[str, ...]:
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
                "^r",
                (EntityCategory(Category.ROBOT),),
                bounds=box((0.5, -1, -1), (20, 1, 1)),
            ),
            ("r2",),
        ),
    ],
)
def test_entities_that_pass_all_filters_are_found(
    filters: EntityFilters, names: tuple[str, ...]
) -> None:
    assert found(make_parts(a_tagged_world()), filters) == names


@pytest.mark.parametrize(
    ("filters", "code", "words"),
    [
        (EntityFilters("("), 4, "filter.pattern"),
        (EntityFilters(tags=TagsFilter(("a",), 7)), 4, "filter.tags: filter_mode 7"),
        (EntityFilters(tags=TagsFilter(tuple(f"t{i}" for i in range(65)))), 4, "65 tags"),
        (EntityFilters(bounds=Bounds(9)), 0, "filter.bounds: type 9 is not known"),
        (EntityFilters(bounds=Bounds(BoundsType.BOX)), 4, "0 points do not make bounds"),
        (EntityFilters(bounds=box((float("nan"), 0, 0), (1, 1, 1))), 4, "not finite"),
        (
            EntityFilters(bounds=Bounds(BoundsType.SPHERE, (Vector3(), Vector3(-1.0)))),
            4,
            "radius -1 is negative",
        ),
        (
            EntityFilters(
                bounds=Bounds(
                    BoundsType.CONVEX_HULL, tuple(Vector3(x, 2.0 * x, 0) for x in (0.0, 1.0, 3.0))
                )
            ),
            4,
            "on one line",
        ),
    ],
)
def test_filters_that_are_none_are_refused(filters: EntityFilters, code: int, words: str) -> None:
    with pytest.raises(SimError, match=words) as error:
        found(make_parts(a_tagged_world()), filters)

    assert error.value.code == code


LARGE = "r|(a?){500}a{500}"
"""Looked for in one name at each turn."""


class SlowWall(WallTime):
    """A clock that goes on whenever it is read."""

    pace_ns = SEARCH_SLICE_NS

    def now_ns(self) -> int:
        self.ns += self.pace_ns
        return self.ns


def test_a_long_search_is_made_in_turns_and_tells_of_the_moment_of_asking() -> None:
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


def test_a_search_without_end_is_given_up() -> None:
    names = [f"r{i}" for i in range(200)]
    parts = make_parts(a_world(*names), wall := SlowWall())
    response = handle_request(parts, entity_messages.GetEntitiesRequest(EntityFilters("r")))
    assert isinstance(response, DeferredResponse)

    wall.pace_ns = 2 * MAX_SEARCH_NS
    while not response.is_ready():
        pass

    with pytest.raises(SearchTooLong, match=r"filter\.time: the filters took more than 1 s"):
        response.outcome()
