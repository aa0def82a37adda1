"""Services on worlds: load, unload, list, and the named poses of the current world."""

from collections.abc import Callable, Iterator

from zensim.proto.messages import entity_messages, spawn_messages, world_messages
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.result_messages import (
    GetAvailableWorldsCode,
    GetCurrentWorldCode,
    LoadWorldCode,
    Result,
    ResultCode,
    SpawnCode,
    UnloadWorldCode,
)
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import IncorrectState, ModelError, RequestRefused, SimError
from zensim.sim_server.parser_process.parser_protocol import ParseResult
from zensim.sim_server.queries.entity_filters import make_tags_test
from zensim.sim_server.service_parts import CurrentWorld, DeferredResponse, WorldLoading
from zensim.sim_server.world.simulated_world import BuiltWorld, SimulatedWorld
from zensim.sim_server.world_loading.file_work import FileWork
from zensim.sim_server.world_loading.world_catalog import (
    ONLINE_SCHEMES,
    WorldSearch,
    WorldText,
    is_file_needed,
)
from zensim.sim_server.world_loading.world_resources import WorldParseJob

EMPTY_WORLD = WorldModel("", gravity=(0.0, 0.0, 0.0))
MAX_FAULTS_SHOWN = 3
WORLD_BUILD_SLICE_NS = 5 * NANOSECONDS // 1000
"""Wall time for building a world per turn of the loop."""
MAX_SOURCES = 64


def load_world(
    loading: WorldLoading, request: world_messages.LoadWorldRequest
) -> DeferredResponse[world_messages.LoadWorldReport]:
    """Parse and build a world while time is stopped, then replace the current one; or keep it."""
    load = _WorldLoad(loading, request)
    return DeferredResponse(load.advance, load.finish)


class _WorldLoad:
    """A world that is found, parsed and built; files are read in threads."""

    def __init__(self, loading: WorldLoading, request: world_messages.LoadWorldRequest) -> None:
        """Refuse at once what needs no file to be refused."""
        self._loading = loading
        self._request = request
        self._refusal: SimError | None = None
        self._finding: FileWork[WorldText] | None = None
        self._refuse_while_loading()
        if is_file_needed(request.world_resource):
            self._finding = FileWork(lambda _: loading.catalog.find(request.world_resource))
        else:
            self._begin(loading.catalog.find(request.world_resource))

    def advance(self) -> bool:
        """Go on for a time slice; return whether it is complete or refused."""
        try:
            if self._finding is not None:
                if not self._finding.is_over():
                    return False
                found = self._finding.outcome()
                self._refuse_while_loading()
                self._finding = None
                self._begin(found)
            return self._building.advance(self._job.poll())
        except SimError as refusal:
            self._refusal = refusal
            return True

    def finish(self) -> world_messages.LoadWorldReport:
        """Replace the world."""
        world = self._loading.world
        try:
            if self._refusal is not None:
                raise self._refusal
            model, built = self._building.outcome()
        except SimError:
            if self._finding is None and world.clock.state == State.LOADING_WORLD:
                world.clock.change_state(self._previous)
            raise
        self._loading.replace_world(built, model, self._resource)
        return world_messages.LoadWorldReport(Result(), self._resource, model.report)

    def _begin(self, found: WorldText) -> None:
        loading, world, request = self._loading, self._loading.world, self._request
        self._resource = found.resource
        self._job = WorldParseJob(
            found.text,
            found.folders,
            loading.descriptions.provider,
            loading.descriptions.store,
            allow_missing=request.ignore_missing_or_unsupported_assets,
        )
        loading.pacing.step_goals.abort("another world is being loaded")
        self._previous = world.clock.state
        world.clock.change_state(State.LOADING_WORLD)
        self._building = _WorldBuild(loading, lambda parsed: _check_parsed_world(parsed, request))

    def _refuse_while_loading(self) -> None:
        clock = self._loading.world.clock
        if clock.state in (State.LOADING_WORLD, State.QUITTING):
            raise IncorrectState(f"the simulation is {clock.state_name}; try again later")


class _WorldBuild:
    """A world built in time slices, while requests are handled."""

    def __init__(self, loading: WorldLoading, checked: Callable[[ParseResult], WorldModel]) -> None:
        self._loading = loading
        self._check_parsed = checked
        self._model = EMPTY_WORLD
        self._parts: Iterator[BuiltWorld | None] | None = None
        self._outcome: BuiltWorld | SimError | None = None

    def advance(self, parsed: ParseResult | None) -> bool:
        """Build for a time slice once the world is parsed; return whether it is complete."""
        if parsed is None:
            return False
        end_ns = self._loading.pacing.now_ns() + WORLD_BUILD_SLICE_NS
        try:
            if self._parts is None:
                self._model = self._check_parsed(parsed)
                self._parts = self._loading.factory(self._model)
            while self._outcome is None:
                self._outcome = next(self._parts)
                if self._loading.pacing.now_ns() >= end_ns:
                    break
        except SimError as error:
            self._outcome = error
        return self._outcome is not None

    def outcome(self) -> tuple[WorldModel, BuiltWorld]:
        """Return the world; raise the SimError if it could not be built."""
        assert self._outcome is not None
        if isinstance(self._outcome, SimError):
            raise self._outcome
        return self._model, self._outcome


def unload_world(
    loading: WorldLoading, _: world_messages.UnloadWorldRequest
) -> world_messages.UnloadWorldResponse:
    """Unload the world: no entities, no ground, no time."""
    world = loading.world
    if world.clock.state == State.NO_WORLD:
        raise RequestRefused(
            UnloadWorldCode.NO_WORLD_LOADED, "no world is loaded; there is nothing to unload"
        )
    if world.clock.state in (State.LOADING_WORLD, State.QUITTING):
        raise IncorrectState(f"the simulation is {world.clock.state_name}; try again later")
    loading.pacing.step_goals.abort("the world was unloaded")
    empty = list(loading.factory(EMPTY_WORLD))[-1]
    assert empty is not None
    loading.replace_world(empty, EMPTY_WORLD, world_messages.WorldResource())
    return world_messages.UnloadWorldResponse()


def get_current_world(
    world: SimulatedWorld, current: CurrentWorld, _: world_messages.GetCurrentWorldRequest
) -> world_messages.GetCurrentWorldResponse:
    """Return the resource of the loaded world."""
    if world.clock.state == State.NO_WORLD:
        raise RequestRefused(
            GetCurrentWorldCode.NO_WORLD_LOADED, "no world is loaded; load one with load_world"
        )
    return world_messages.GetCurrentWorldResponse(world=current.resource)


def get_available_worlds(
    loading: WorldLoading, request: world_messages.GetAvailableWorldsRequest
) -> DeferredResponse[world_messages.GetAvailableWorldsResponse]:
    """List the worlds that can be loaded, the server's own first; a few files per turn."""
    left_out = ONLINE_SCHEMES if request.offline_only else ()
    sources = [one for one in request.additional_sources if not one.startswith(left_out)]
    if len(sources) > MAX_SOURCES:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"{len(sources)} sources are too many; use {MAX_SOURCES} or less",
        )
    listing = _WorldListing(loading.catalog.search(sources))
    return DeferredResponse(
        listing.advance, lambda: _make_worlds_response(listing.outcome(), request)
    )


class _WorldListing:
    """A search whose files are read in a thread, a few in each turn."""

    def __init__(self, search: WorldSearch) -> None:
        self._search = search
        self._reading = self._read_more()

    def advance(self) -> bool:
        """Read a few more files; return whether the search is over, or stalled."""
        if not self._reading.is_over():
            return False
        if self._reading.is_stalled or self._search.is_over:
            return True
        self._reading = self._read_more()
        return False

    def outcome(self) -> WorldSearch:
        """Return the search; raise FilesStalled if a file system does not answer."""
        self._reading.outcome()
        return self._search

    def _read_more(self) -> FileWork[bool]:
        return FileWork(lambda _: self._search.advance())


def _make_worlds_response(
    search: WorldSearch, request: world_messages.GetAvailableWorldsRequest
) -> world_messages.GetAvailableWorldsResponse:
    reasons = "; ".join(failure.reason for failure in search.failures[:MAX_FAULTS_SHOWN])
    if search.failures and not request.continue_on_error:
        is_own = any(failure.is_own for failure in search.failures)
        raise RequestRefused(
            GetAvailableWorldsCode.DEFAULT_SOURCES_FAILED if is_own else ResultCode.NOT_FOUND,
            f"{reasons}; set continue_on_error to leave them out",
        )
    found = {world.world_resource.uri: world for world in search.worlds}
    wanted = tuple(world for world in found.values() if _matches_tags(world, request.filter))
    return world_messages.GetAvailableWorldsResponse(Result(ResultCode.OK, reasons), wanted)


def _matches_tags(world: world_messages.WorldResource, wanted: entity_messages.TagsFilter) -> bool:
    matches = all if wanted.filter_mode else any
    return not wanted.tags or matches(tag in world.tags for tag in wanted.tags)


def _check_parsed_world(
    parsed: ParseResult, request: world_messages.LoadWorldRequest
) -> WorldModel:
    """Return the parsed world unless the request refuses its report.

    Raises:
        SimError: The world is refused.
    """
    if parsed.world is None:
        raise ModelError(parsed.message, code=_to_load_code(parsed.code), slug=parsed.slug)
    report = parsed.world.report
    if not request.ignore_missing_or_unsupported_assets:
        unusable = [ReportEntry("suspicious", "mesh", reason) for reason in parsed.unusable]
        _refuse_entries(unusable, LoadWorldCode.UNSUPPORTED_ASSETS, "unusable")
    if request.fail_on_unsupported_element:
        others = [entry for entry in report if entry.status != "applied"]
        _refuse_entries(others, LoadWorldCode.UNSUPPORTED_ELEMENTS, "unsupported")
    return parsed.world


def _refuse_entries(entries: list[ReportEntry], code: LoadWorldCode, what: str) -> None:
    if not entries:
        return
    named = "; ".join(f"{entry.subject}: {entry.reason}" for entry in entries[:MAX_FAULTS_SHOWN])
    more = (
        f"; and {len(entries) - MAX_FAULTS_SHOWN} more" if len(entries) > MAX_FAULTS_SHOWN else ""
    )
    raise ModelError(f"{len(entries)} {what}: {named}{more}", code=code, slug=f"world.{what}")


def _to_load_code(code: int) -> int:
    """Translate a code of SpawnEntity into one of LoadWorld; common codes stay."""
    names = {code.value: code.name for code in SpawnCode}
    return LoadWorldCode[names[code]] if code in names else code


def get_named_poses(
    current: CurrentWorld, request: spawn_messages.GetNamedPosesRequest
) -> spawn_messages.GetNamedPosesResponse:
    """List the named poses that pass a filter of tags."""
    passes = make_tags_test(request.tags)
    found = (one.pose for one in current.model.named_poses if passes(one.pose.tags))
    return spawn_messages.GetNamedPosesResponse(poses=tuple(found))


def get_named_pose_bounds(
    current: CurrentWorld, request: spawn_messages.GetNamedPoseBoundsRequest
) -> spawn_messages.GetNamedPoseBoundsResponse:
    """Return the bounds of a named pose."""
    for one in current.model.named_poses:
        if one.pose.name == request.name:
            return spawn_messages.GetNamedPoseBoundsResponse(bounds=one.bounds)
    raise RequestRefused(
        ResultCode.NOT_FOUND,
        f"no pose {request.name[:80]!r} in this world; 'get_named_poses' lists them",
    )
