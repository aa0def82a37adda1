"""Which entities pass the filters of a request; a hostile filter holds nobody up."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import msgspec

from zensim.proto.messages.entity_messages import MAX_TAGS, EntityFilters, FilterMode, TagsFilter
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.errors import SimError
from zensim.sim_server.lookup.patterns import Pattern
from zensim.sim_server.lookup.regions import Region, Sight, overlapping, region_of
from zensim.sim_server.server_context import DeferredResponse, ServerContext
from zensim.sim_server.world.entity import Entity

Answer = TypeVar("Answer", bound=msgspec.Struct)

SLICE_NS = 2 * NANOSECONDS // 1000
"""What a search takes of each turn of the loop, or a quarter of a step where that is more."""
LONGEST_NS = NANOSECONDS
"""What a search may take in all."""


class TagsRefused(SimError):
    """A filter of tags that is none."""

    slug = "filter.tags"


class SearchTooLong(SimError):
    """A search that was given up."""

    slug = "filter.time"


def passing(
    context: ServerContext,
    filters: EntityFilters,
    answer: Callable[[tuple[str, ...]], Answer],
) -> Answer | DeferredResponse:
    """Answer with the names that pass, in the order of spawning: at once, or some turns later.

    Either way they are those that pass at the moment of asking.

    Raises:
        SimError: A filter is refused.
    """
    region = region_of(filters.bounds)
    pattern = Pattern(filters.filter) if filters.filter else None
    found = _told_apart(context.world.entities, filters)
    if region is None and pattern is None:
        return answer(tuple(entity.name for entity in found))
    sight = Sight(context.world.roster(), context.world.reading(), context.store.corners)
    search = _Search(sight, found, context.now_ns, context.loop_stats.work_budget_ns(SLICE_NS))
    search.begin(pattern, region)
    if search.go_on():
        return answer(search.outcome())
    return DeferredResponse(search.go_on, lambda: answer(search.outcome()))


class _Search:
    """Goes on a little whenever it is asked whether it is over."""

    def __init__(
        self, sight: Sight, entities: Sequence[Entity], now_ns: Callable[[], int], slice_ns: int
    ) -> None:
        self._sight = sight
        self._entities = {entity.name: entity for entity in entities}
        self._now_ns = now_ns
        self._slice_ns = slice_ns
        self._taken_ns = 0
        self._work: Iterator[None] = iter(())

    def begin(self, pattern: Pattern | None, region: Region | None) -> None:
        self._work = self._narrowed(pattern, region)

    def go_on(self) -> bool:
        start_ns = self._now_ns()
        for _ in self._work:
            took_ns = self._now_ns() - start_ns
            if took_ns >= self._slice_ns:
                self._taken_ns += took_ns
                return self._taken_ns > LONGEST_NS
        return True

    def outcome(self) -> tuple[str, ...]:
        if self._taken_ns > LONGEST_NS:
            raise SearchTooLong(
                f"the filters took more than {LONGEST_NS / NANOSECONDS:g} s; use simpler ones"
            )
        return tuple(self._entities)

    def _narrowed(self, pattern: Pattern | None, region: Region | None) -> Iterator[None]:
        if pattern is not None:
            yield from self._keep(pattern.search(list(self._entities)))
        if region is not None:
            yield from self._keep(overlapping(self._sight, [*self._entities.values()], region))

    def _keep(self, found: Iterator[list[str]]) -> Iterator[None]:
        kept: set[str] = set()
        for names in found:
            kept.update(names)
            yield
        self._entities = {name: one for name, one in self._entities.items() if name in kept}


def _told_apart(entities: Sequence[Entity], filters: EntityFilters) -> list[Entity]:
    categories = {wanted.category for wanted in filters.categories}
    passes = tags_test(filters.tags)
    return [
        entity
        for entity in entities
        if (not categories or entity.info.category.category in categories)
        and passes(entity.info.tags)
    ]


def tags_test(wanted: TagsFilter) -> Callable[[Sequence[str]], bool]:
    """Make the test that tags pass a filter.

    Raises:
        TagsRefused: There are too many tags, or the mode is not known.
    """
    if wanted.filter_mode not in set(FilterMode):
        raise TagsRefused(f"filter_mode {wanted.filter_mode} is not known; use 0 (any) or 1 (all)")
    tags = set(wanted.tags)
    if len(tags) > MAX_TAGS:
        raise TagsRefused(f"{len(tags)} tags are too many; use at most {MAX_TAGS}")
    if not tags:
        return lambda _: True
    if wanted.filter_mode == FilterMode.ALL:
        return tags.issubset
    return lambda given: not tags.isdisjoint(given)
