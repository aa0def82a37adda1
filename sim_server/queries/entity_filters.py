"""Filters entities by category, tags, regular expression and bounds, in time slices."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

import msgspec
import re2

from zensim.proto.messages.entity_messages import MAX_TAGS, EntityFilters, FilterMode, TagsFilter
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.errors import SimError
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.queries.bounds_queries import (
    PoseSnapshot,
    Region,
    find_overlapping,
    parse_bounds,
)
from zensim.sim_server.service_parts import DeferredResponse, Pacing
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.simulated_world import World

MAX_PATTERN_CHARACTERS = 1024
MAX_AUTOMATON_BYTES = 1 << 16
"""Of memory for the automata of one pattern: bounds the time that each character takes."""
MAX_NAMES_PER_TURN = 256
INSTRUCTIONS_PER_TURN = 4096
"""Of the automaton, times the names that it is run on before anybody else gets a turn."""


class PatternRefused(SimError):
    """A regular expression that is none."""

    slug = "filter.pattern"


class PosixPattern:
    """A regular expression that is looked for in names, anywhere within.

    Its engine knows no backtracking: time is linear in the names, whatever the pattern.

    Raises:
        PatternRefused: It is no POSIX extended regular expression, too long or too large.
    """

    def __init__(self, text: str) -> None:
        if len(text) > MAX_PATTERN_CHARACTERS:
            raise PatternRefused(
                f"{len(text)} characters are too many; use at most {MAX_PATTERN_CHARACTERS}"
            )
        try:
            re2.compile(text, _make_options())  # by itself, so that its brackets match within it
            self._lines = re2.compile(f"^.*({text}).*$", _make_options())
        except (re2.error, UnicodeEncodeError) as error:
            raise PatternRefused(
                f"{text[:80]!r} is no POSIX extended regular expression: {_format_reason(error)}"
            ) from error
        finally:
            re2.purge()

    def search(self, names: Sequence[str]) -> Iterator[list[str]]:
        """Name those that hold a match, from some names at each turn: fewer for large patterns."""
        count = INSTRUCTIONS_PER_TURN // max(self._lines.programsize, 1)
        count = min(max(count, 1), MAX_NAMES_PER_TURN)
        for at in range(0, len(names), count):
            text = "\n".join(names[at : at + count]).encode()
            yield [match.group().decode() for match in self._lines.finditer(text)]


def _make_options() -> re2.Options:
    options = re2.Options()
    options.posix_syntax = True
    options.one_line = False
    options.never_nl = True
    options.never_capture = True
    options.log_errors = False
    options.max_mem = MAX_AUTOMATON_BYTES
    return options


def _format_reason(error: Exception) -> str:
    said = error.args[0] if error.args else ""
    return said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)


FilterResponse = TypeVar("FilterResponse", bound=msgspec.Struct)

SEARCH_SLICE_NS = 2 * NANOSECONDS // 1000
"""What a search takes of each turn of the loop, or a quarter of a step where that is more."""
MAX_SEARCH_NS = NANOSECONDS
"""What a search may take in all."""


class TagsRefused(SimError):
    """A filter of tags that is none."""

    slug = "filter.tags"


class SearchTooLong(SimError):
    """A search that was given up."""

    slug = "filter.time"


def filter_entities(
    world: World,
    store: AssetStore,
    pacing: Pacing,
    filters: EntityFilters,
    answer: Callable[[tuple[str, ...]], FilterResponse],
) -> FilterResponse | DeferredResponse[FilterResponse]:
    """Answer with the names that pass, in the order of spawning: at once, or some turns later.

    Either way they are those that pass at the moment of asking.

    Raises:
        SimError: A filter is refused.
    """
    region = parse_bounds(filters.bounds)
    pattern = PosixPattern(filters.filter) if filters.filter else None
    found = _filter_by_info(world.entities, filters)
    if region is None and pattern is None:
        return answer(tuple(entity.name for entity in found))
    sight = PoseSnapshot(world.entities.index, world.states(), store.corners)
    search = _EntitySearch(
        sight, found, pacing.now_ns, pacing.loop_stats.work_budget_ns(SEARCH_SLICE_NS)
    )
    search.begin(pattern, region)
    if search.go_on():
        return answer(search.outcome())
    return DeferredResponse(search.go_on, lambda: answer(search.outcome()))


class _EntitySearch:
    """Goes on a little whenever it is asked whether it is over."""

    def __init__(
        self,
        sight: PoseSnapshot,
        entities: Sequence[Entity],
        now_ns: Callable[[], int],
        slice_ns: int,
    ) -> None:
        self._sight = sight
        self._entities = {entity.name: entity for entity in entities}
        self._now_ns = now_ns
        self._slice_ns = slice_ns
        self._taken_ns = 0
        self._work: Iterator[None] = iter(())

    def begin(self, pattern: PosixPattern | None, region: Region | None) -> None:
        self._work = self._run_filters(pattern, region)

    def go_on(self) -> bool:
        start_ns = self._now_ns()
        for _ in self._work:
            took_ns = self._now_ns() - start_ns
            if took_ns >= self._slice_ns:
                self._taken_ns += took_ns
                return self._taken_ns > MAX_SEARCH_NS
        return True

    def outcome(self) -> tuple[str, ...]:
        if self._taken_ns > MAX_SEARCH_NS:
            raise SearchTooLong(
                f"the filters took more than {MAX_SEARCH_NS / NANOSECONDS:g} s; use simpler ones"
            )
        return tuple(self._entities)

    def _run_filters(self, pattern: PosixPattern | None, region: Region | None) -> Iterator[None]:
        if pattern is not None:
            yield from self._keep(pattern.search(list(self._entities)))
        if region is not None:
            yield from self._keep(find_overlapping(self._sight, [*self._entities.values()], region))

    def _keep(self, found: Iterator[list[str]]) -> Iterator[None]:
        kept: set[str] = set()
        for names in found:
            kept.update(names)
            yield
        self._entities = {name: one for name, one in self._entities.items() if name in kept}


def _filter_by_info(entities: Iterable[Entity], filters: EntityFilters) -> list[Entity]:
    categories = {wanted.category for wanted in filters.categories}
    passes = make_tags_test(filters.tags)
    return [
        entity
        for entity in entities
        if (not categories or entity.info.category.category in categories)
        and passes(entity.info.tags)
    ]


def make_tags_test(wanted: TagsFilter) -> Callable[[Sequence[str]], bool]:
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
