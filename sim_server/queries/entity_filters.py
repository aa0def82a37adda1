"""Filters entities by category, tags, regular expression and bounds, in time slices."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

import msgspec
import re2

from zensim.proto.messages.entity_messages import MAX_TAGS, EntityFilters, FilterMode, TagsFilter
from zensim.sim_server.errors import SimError
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.queries.bounds_queries import parse_bounds
from zensim.sim_server.queries.sliced_work import MAX_WORK_S, SlicedWork
from zensim.sim_server.scene.scene import CollisionScene, Region
from zensim.sim_server.service_parts import DeferredResponse, Pacing
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.simulated_world import SimulatedWorld

MAX_PATTERN_CHARACTERS = 1024
MAX_AUTOMATON_BYTES = 1 << 16
"""Memory for the automata of one pattern; it bounds the time that each character takes."""
MAX_NAMES_PER_TURN = 256
INSTRUCTIONS_PER_TURN = 4096
"""Instructions of the automaton times names that are searched in one turn."""


class PatternRefused(SimError):
    """A regular expression that is not valid."""

    slug = "filter.pattern"


class PosixPattern:
    """A POSIX extended regular expression that is searched for in names.

    RE2 does not backtrack: time is linear in the length of the names for any pattern.

    Raises:
        PatternRefused: It is not valid, too long or too large.
    """

    def __init__(self, text: str) -> None:
        if len(text) > MAX_PATTERN_CHARACTERS:
            raise PatternRefused(
                f"{len(text)} characters are too many; use at most {MAX_PATTERN_CHARACTERS}"
            )
        try:
            re2.compile(text, _make_options())  # alone, so that its brackets balance
            self._lines = re2.compile(f"^.*({text}).*$", _make_options())
        except (re2.error, UnicodeEncodeError) as error:
            raise PatternRefused(
                f"{text[:80]!r} is not a POSIX extended regular expression: {_format_reason(error)}"
            ) from error
        finally:
            re2.purge()

    def search(self, names: Sequence[str]) -> Iterator[list[str]]:
        """Yield the names that match, some names in each turn: fewer for large patterns."""
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
    reason = error.args[0] if error.args else ""
    return reason.decode("utf-8", "replace") if isinstance(reason, bytes) else str(reason)


FilterResponse = TypeVar("FilterResponse", bound=msgspec.Struct)


class TagsRefused(SimError):
    """A tags filter that is not valid."""

    slug = "filter.tags"


class SearchTooLong(SimError):
    """A search that took too long."""

    slug = "filter.time"


def filter_entities(
    world: SimulatedWorld,
    store: AssetStore,
    pacing: Pacing,
    filters: EntityFilters,
    make_response: Callable[[tuple[str, ...]], FilterResponse],
) -> FilterResponse | DeferredResponse[FilterResponse]:
    """Respond with the names that pass, in the order of spawning: at once, or some turns later.

    The entities are filtered as they are now in both cases.

    Raises:
        SimError: A filter is refused.
    """
    region = parse_bounds(filters.bounds)
    pattern = PosixPattern(filters.filter) if filters.filter else None
    found = _filter_by_info(world.entities, filters)
    if region is None and pattern is None:
        return make_response(tuple(entity.name for entity in found))
    search = _EntitySearch(
        world.scene(store.vertices, store.corners), world.entities.index.row, found
    )
    work = SlicedWork(search.run(pattern, region), pacing)
    return work.respond(lambda: _finish_search(work, search, make_response))


def _finish_search(
    work: SlicedWork,
    search: "_EntitySearch",
    make_response: Callable[[tuple[str, ...]], FilterResponse],
) -> FilterResponse:
    if work.is_too_long:
        raise SearchTooLong(f"the filters took more than {MAX_WORK_S:g} s; use simpler ones")
    return make_response(search.found)


class _EntitySearch:
    """A search that is made in steps."""

    def __init__(
        self, scene: CollisionScene, rows: Mapping[str, int], entities: Sequence[Entity]
    ) -> None:
        self._scene = scene
        self._rows = rows
        self._entities = {entity.name: entity for entity in entities}

    @property
    def found(self) -> tuple[str, ...]:
        """The entities that pass, after the last step."""
        return tuple(self._entities)

    def run(self, pattern: PosixPattern | None, region: Region | None) -> Iterator[None]:
        if pattern is not None:
            yield from self._keep_found(pattern.search(list(self._entities)))
        if region is not None:
            yield from self._keep_found(self._find_overlaps(region))

    def _find_overlaps(self, region: Region) -> Iterator[list[str]]:
        names = {self._rows[name]: name for name in self._entities}
        for found in self._scene.iter_overlaps(region, list(names)):
            yield [names[row] for row in found]

    def _keep_found(self, found: Iterator[list[str]]) -> Iterator[None]:
        matching: set[str] = set()
        for names in found:
            matching.update(names)
            yield
        self._entities = {name: one for name, one in self._entities.items() if name in matching}


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
    """Make a function that tests tags against a filter.

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
