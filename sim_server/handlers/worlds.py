"""Worlds: putting another in the place of this one, taking it away, and telling which there are."""

from collections.abc import Callable, Iterator

from zensim.proto.messages import entity_messages, world_messages
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
from zensim.sim_server.description.sdf.sdf_world import WorldModel
from zensim.sim_server.desk import Desk, Founded
from zensim.sim_server.errors import IncorrectState, ModelError, Refused, SimError
from zensim.sim_server.later import Later
from zensim.sim_server.reading.messages import TextRead
from zensim.sim_server.worlds.atlas import ONLINE, Search
from zensim.sim_server.worlds.world_reading import WorldReading

NOTHING = WorldModel("", gravity=(0.0, 0.0, 0.0))
SHOWN = 3
SLICE_NS = 5 * NANOSECONDS // 1000
"""What making a world takes of each turn of the loop; the part last begun is finished."""
MAX_SOURCES = 64
MISSING = "is not on the server"


def load_world(desk: Desk, request: world_messages.LoadWorldRequest) -> Later:
    """Read a world while time stands, then put it in the place of this one; or leave this one."""
    former = desk.world.state
    if former in (State.LOADING_WORLD, State.QUITTING):
        raise IncorrectState(f"the simulation is {desk.world.state_name}; try again later")
    found = desk.atlas.find(request.world_resource)
    is_lenient = request.ignore_missing_or_unsupported_assets
    reading = WorldReading(
        found.text, found.folders, desk.descriptions, desk.store, allow_missing=is_lenient
    )
    desk.stepping.abort("another world is being loaded")
    desk.world.enter(State.LOADING_WORLD)
    building = _Building(desk, lambda answer: _checked(answer, request))

    def put() -> world_messages.LoadWorldReport:
        try:
            model, founded = building.outcome()
        except SimError:
            if desk.world.state == State.LOADING_WORLD:
                desk.world.enter(former)
            raise
        desk.replace_world(founded, model, found.resource)
        return world_messages.LoadWorldReport(Result(), desk.resource, model.report)

    return Later(lambda: building.go_on(reading.answer), put)


class _Building:
    """A world that is made while requests are answered."""

    def __init__(self, desk: Desk, checked: Callable[[TextRead], WorldModel]) -> None:
        self._desk = desk
        self._checked = checked
        self._model = NOTHING
        self._parts: Iterator[Founded | None] | None = None
        self._outcome: Founded | SimError | None = None

    def go_on(self, answer: TextRead | None) -> bool:
        """Make some parts once the world is read; say whether that was the last."""
        if answer is None:
            return False
        end_ns = self._desk.now_ns() + SLICE_NS
        try:
            if self._parts is None:
                self._model = self._checked(answer)
                self._parts = self._desk.founding(self._model)
            while self._outcome is None:
                self._outcome = next(self._parts)
                if self._desk.now_ns() >= end_ns:
                    break
        except SimError as error:
            self._outcome = error
        return self._outcome is not None

    def outcome(self) -> tuple[WorldModel, Founded]:
        """Give the world; raises SimError where it could not be made."""
        assert self._outcome is not None
        if isinstance(self._outcome, SimError):
            raise self._outcome
        return self._model, self._outcome


def unload_world(
    desk: Desk, _: world_messages.UnloadWorldRequest
) -> world_messages.UnloadWorldResponse:
    """Leave nothing: no entities, no ground, no time."""
    if desk.world.state == State.NO_WORLD:
        raise Refused(UnloadWorldCode.NO_WORLD_LOADED, "no world is loaded; there is nothing to do")
    if desk.world.state in (State.LOADING_WORLD, State.QUITTING):
        raise IncorrectState(f"the simulation is {desk.world.state_name}; try again later")
    desk.stepping.abort("the world was unloaded")
    nothing = list(desk.founding(NOTHING))[-1]
    assert nothing is not None
    desk.replace_world(nothing, NOTHING, world_messages.WorldResource())
    return world_messages.UnloadWorldResponse()


def get_current_world(
    desk: Desk, _: world_messages.GetCurrentWorldRequest
) -> world_messages.GetCurrentWorldResponse:
    """Tell which world is there."""
    if desk.world.state == State.NO_WORLD:
        raise Refused(
            GetCurrentWorldCode.NO_WORLD_LOADED, "no world is loaded; load one with load_world"
        )
    return world_messages.GetCurrentWorldResponse(world=desk.resource)


def get_available_worlds(desk: Desk, request: world_messages.GetAvailableWorldsRequest) -> Later:
    """List the worlds that can be loaded, those of the server first; a few files at each turn."""
    sources = [one for one in request.additional_sources if not _is_skipped(one, request)]
    if len(sources) > MAX_SOURCES:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"{len(sources)} sources are too many; use {MAX_SOURCES} or less",
        )
    search = desk.atlas.search(sources)
    return Later(lambda: search.is_over or search.go_on(), lambda: _listed(search, request))


def _is_skipped(source: str, request: world_messages.GetAvailableWorldsRequest) -> bool:
    return request.offline_only and source.startswith(ONLINE)


def _listed(
    search: Search, request: world_messages.GetAvailableWorldsRequest
) -> world_messages.GetAvailableWorldsResponse:
    reasons = "; ".join(failure.reason for failure in search.failures[:SHOWN])
    if search.failures and not request.continue_on_error:
        is_own = any(failure.is_own for failure in search.failures)
        raise Refused(
            GetAvailableWorldsCode.DEFAULT_SOURCES_FAILED if is_own else ResultCode.NOT_FOUND,
            f"{reasons}; set continue_on_error to do without",
        )
    found = {world.world_resource.uri: world for world in search.worlds}
    wanted = tuple(world for world in found.values() if _passes(world, request.filter))
    return world_messages.GetAvailableWorldsResponse(Result(ResultCode.OK, reasons), wanted)


def _passes(world: world_messages.WorldResource, wanted: entity_messages.TagsFilter) -> bool:
    asks = all if wanted.filter_mode else any
    return not wanted.tags or asks(tag in world.tags for tag in wanted.tags)


def _checked(answer: TextRead, request: world_messages.LoadWorldRequest) -> WorldModel:
    """Take what was read, unless the request is stricter.

    Raises:
        SimError: It cannot be used.
    """
    if answer.world is None:
        raise ModelError(answer.message, code=_code(answer.code), slug=answer.slug)
    report = answer.world.report
    if not request.ignore_missing_or_unsupported_assets:
        missing = [entry for entry in report if MISSING in entry.reason]
        _refuse(missing, LoadWorldCode.MISSING_ASSETS, "missing")
        unusable = [ReportEntry("suspicious", "mesh", reason) for reason in answer.unusable]
        _refuse(unusable, LoadWorldCode.UNSUPPORTED_ASSETS, "unusable")
    if request.fail_on_unsupported_element:
        others = [entry for entry in report if entry.status != "applied"]
        _refuse(others, LoadWorldCode.UNSUPPORTED_ELEMENTS, "unsupported")
    return answer.world


def _refuse(entries: list[ReportEntry], code: LoadWorldCode, what: str) -> None:
    if not entries:
        return
    named = "; ".join(f"{entry.subject}: {entry.reason}" for entry in entries[:SHOWN])
    more = f"; and {len(entries) - SHOWN} more" if len(entries) > SHOWN else ""
    raise ModelError(f"{len(entries)} {what}: {named}{more}", code=code, slug=f"world.{what}")


def _code(code: int) -> int:
    """Translate a code of SpawnEntity into one of LoadWorld; those of every service stay."""
    names = {code.value: code.name for code in SpawnCode}
    return LoadWorldCode[names[code]] if code in names else code
