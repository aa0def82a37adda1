"""Many spawns in one request: one after another over some turns, or all between two steps."""

from collections.abc import Iterator

import msgspec

from proto.fleets import (
    HELD_BACK,
    MAX_SPAWNS,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntity,
    SpawnResult,
)
from proto.header import NANOSECONDS
from proto.model import Model
from proto.result import Result, ResultCode, SpawnEntitiesCode
from proto.services import Resource, SpawnEntityOrder
from sim_server.desk import Desk
from sim_server.errors import Refused, SimError
from sim_server.later import Later
from sim_server.spawning import spawn_model

SLICE_NS = 5 * NANOSECONDS // 1000
"""What spawning one by one takes of each turn of the loop; the last begun is finished.

Where a quarter of a step is more, it is that.
"""
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

    def _spawn(self, order: SpawnEntityOrder) -> SpawnResult:
        read = self._read[id(order.entity_resource)]
        if isinstance(read, SimError):
            raise read
        report = spawn_model(self._desk, order, *read)
        return SpawnResult(report.result, report.entity_name)

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
        end_ns = self._desk.now_ns() + self._desk.meter.share_ns(SLICE_NS)
        for has_spawned in self._work:
            if not has_spawned or self._desk.now_ns() >= end_ns:
                return False
        return True

    def _spawned(self) -> Iterator[bool]:
        for order in self._orders:
            while not self._is_read(order):
                yield False
            try:
                self._results.append(self._spawn(order))
            except SimError as error:
                self._results.append(_refused(error))
            yield True


class _Rehearsed(SimError):
    """All could be spawned, and was only to be tried."""


class _Together(_Fleet):
    """All orders between two steps, or none."""

    def __init__(self, desk: Desk, orders: list[SpawnEntityOrder]) -> None:
        self._is_rehearsal = any(order.dry_run for order in orders)
        replace = msgspec.structs.replace
        super().__init__(desk, [replace(order, dry_run=False) for order in orders])
        self._unread = list({id(one.entity_resource): one for one in self._orders}.values())
        self._has_begun = False

    def go_on(self) -> bool:
        """Spawn all once all is read; say whether that is over."""
        if self._desk.has_read or not self._has_begun:
            self._has_begun = True
            self._take_read()
        if self._unread:
            return False
        bonded = {bond: list(names) for bond, names in self._desk.bonded.items()}
        try:
            self._spawn_all()
        except SimError as error:
            self._desk.bonded = bonded
            if not isinstance(error, _Rehearsed):
                self._give_up(error)
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

    def _spawn_all(self) -> None:
        with self._desk.world.all_or_none():
            for order in self._orders:
                self._results.append(self._spawn(order))
            if self._is_rehearsal:
                raise _Rehearsed("")

    def _give_up(self, error: SimError) -> None:
        failed = len(self._results)
        name = self._orders[failed].name or f"number {failed}"
        reason = f"{HELD_BACK} '{name[:80]}': all or none were asked for"
        other = SpawnResult(Result(ResultCode.OPERATION_FAILED, reason))
        self._results = [other] * len(self._orders)
        self._results[failed] = _refused(error)


def _refused(error: SimError) -> SpawnResult:
    return SpawnResult(Result(int(error.code), str(error)))
