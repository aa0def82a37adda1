"""Many spawns in one request: one after another over some turns, or all between two steps."""

from collections.abc import Iterator

import msgspec

from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import Result, ResultCode, SpawnEntitiesCode
from zensim.proto.messages.spawn_messages import (
    MAX_SPAWNS,
    NOT_SPAWNED_PREFIX,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntity,
    SpawnEntityOrder,
    SpawnResult,
)
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Refused, SimError
from zensim.sim_server.later import Later
from zensim.sim_server.spawning import Expected, expect_model, let_in, spawn_model

SLICE_NS = 5 * NANOSECONDS // 1000
"""What spawning takes of each turn of the loop where steps are late; the last begun is finished.

Where a quarter of a step is more, it is that.
"""
SPARE_NS = NANOSECONDS // 1000
"""Where that much is left before the next step is due, spawning takes what is left."""
AHEAD = 64
"""Descriptions that are waited for at once."""
Read = tuple[Model, str] | SimError


def spawn_entities(desk: Desk, request: SpawnEntitiesOrder) -> SpawnEntitiesResponse | Later:
    """Put entities into the world: as many as can be, or all or none."""
    if len(request.spawn_requests) > MAX_SPAWNS:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"{len(request.spawn_requests)} spawns are too many; use {MAX_SPAWNS} at most",
        )
    orders = [_order(request.common, one) for one in request.spawn_requests]
    fleet = _Together(desk, orders) if request.atomic else _OneByOne(desk, orders)
    return fleet.response() if fleet.go_on() else Later(fleet.go_on, fleet.response)


def _order(common: SpawnEntityOrder, one: SpawnEntity) -> SpawnEntityOrder:
    has_own = one.entity_resource != Resource()
    return msgspec.structs.replace(
        common,
        name=one.name,
        allow_renaming=one.allow_renaming or common.allow_renaming,
        entity_resource=one.entity_resource if has_own else common.entity_resource,
        entity_namespace=one.entity_namespace,
        initial_pose=one.initial_pose,
    )


class _Fleet:
    """Orders, and what became of them so far."""

    def __init__(self, desk: Desk, orders: list[SpawnEntityOrder]) -> None:
        self._desk = desk
        self._orders = orders
        self._results: list[SpawnResult] = []
        self._read: dict[int, Read] = {}

    def _is_read(self, order: SpawnEntityOrder) -> bool:
        """Whether the description of an order is read; it is kept until all is over."""
        # Orders that share a resource share the object; to compare texts would take long.
        number = id(order.entity_resource)
        if number not in self._read and self._desk.descriptions.is_read(order):
            try:
                self._read[number] = self._desk.descriptions.model(order)
            except SimError as error:
                self._read[number] = error
        return number in self._read

    def _is_prepared(self, order: SpawnEntityOrder) -> bool:
        """Whether the engine would not hold steps up to add what was read; else it gets ready."""
        read = self._read[id(order.entity_resource)]
        return isinstance(read, SimError) or self._desk.world.prepare(read[0])

    def _model(self, order: SpawnEntityOrder) -> tuple[Model, str]:
        read = self._read[id(order.entity_resource)]
        if isinstance(read, SimError):
            raise read
        return read

    def response(self) -> SpawnEntitiesResponse:
        """Say what became of each."""
        failed = [one for one in self._results if one.result.result != ResultCode.OK]
        if not failed:
            return SpawnEntitiesResponse(results=tuple(self._results))
        message = f"{len(failed)} of {len(self._results)} were not spawned; the results say why"
        return SpawnEntitiesResponse(
            Result(SpawnEntitiesCode.ENTITIES_SPAWN_FAILED, message), tuple(self._results)
        )


class _OneByOne(_Fleet):
    """Each order for itself; steps are made meanwhile."""

    def __init__(self, desk: Desk, orders: list[SpawnEntityOrder]) -> None:
        super().__init__(desk, orders)
        self._work = self._spawned()

    def go_on(self) -> bool:
        """Spawn for a while; say whether that was the last."""
        end_ns = _end_of_slice(self._desk)
        for has_spawned in self._work:
            if not has_spawned or self._desk.now_ns() >= end_ns:
                return False
        return True

    def _spawned(self) -> Iterator[bool]:
        for order in self._orders:
            while not (self._is_read(order) and self._is_prepared(order)):
                yield False
            try:
                report = spawn_model(self._desk, order, *self._model(order))
                self._results.append(SpawnResult(report.result, report.entity_name))
            except SimError as error:
                self._results.append(_refused(error))
            yield True


class _Together(_Fleet):
    """All orders between two steps, or none; they are made before, out of sight."""

    def __init__(self, desk: Desk, orders: list[SpawnEntityOrder]) -> None:
        self._is_rehearsal = any(order.dry_run for order in orders)
        replace = msgspec.structs.replace
        super().__init__(desk, [replace(order, dry_run=False) for order in orders])
        self._unread = list({id(one.entity_resource): one for one in self._orders}.values())
        self._has_begun = False
        self._expected: list[Expected] = []

    def go_on(self) -> bool:
        """Make some once all is read; let all in with the last; say whether that is over."""
        if self._desk.has_read or not self._has_begun:
            self._has_begun = True
            self._take_read()
        if self._unread:
            return False
        try:
            if not self._make_some() or not self._desk.world.is_idle:
                return False
            if not self._is_rehearsal:
                let_in(self._desk, self._expected)
        except SimError as error:
            self._give_up(error)
        self._desk.world.turn_away(one.entity for one in self._expected)
        return True

    def _take_read(self) -> None:
        waiting: list[SpawnEntityOrder] = []
        for at, order in enumerate(self._unread):
            if len(waiting) == AHEAD:
                waiting.extend(self._unread[at:])
                break
            if not self._is_read(order):
                waiting.append(order)
        self._unread = waiting

    def _make_some(self) -> bool:
        """Make entities while there is time; say whether none is left to be made."""
        end_ns = _end_of_slice(self._desk)
        for order in self._orders[len(self._expected) :]:
            if not self._is_prepared(order):
                break
            made = expect_model(self._desk, order, *self._model(order))
            self._expected.append(made)
            self._results.append(SpawnResult(Result(), made.entity.name))
            if self._desk.now_ns() >= end_ns:
                break
        return len(self._expected) == len(self._orders)

    def _give_up(self, error: SimError) -> None:
        failed = len(self._results)
        if failed == len(self._orders):
            self._results = [_refused(error)] * failed
            return
        name = self._orders[failed].name or f"number {failed}"
        reason = f"{NOT_SPAWNED_PREFIX} '{name[:80]}': all or none were asked for"
        other = SpawnResult(Result(ResultCode.OPERATION_FAILED, reason))
        self._results = [other] * len(self._orders)
        self._results[failed] = _refused(error)


def _end_of_slice(desk: Desk) -> int:
    """Say until when spawning may hold the loop up: steps that can be in time are to be so."""
    now_ns = desk.now_ns()
    if desk.due_ns - now_ns > SPARE_NS:
        return desk.due_ns - SPARE_NS // 2
    return now_ns + desk.meter.share_ns(SLICE_NS)


def _refused(error: SimError) -> SpawnResult:
    return SpawnResult(Result(int(error.code), str(error)))
