"""One vehicle: its order, instant actions, errors, battery and load; no network."""

from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import msgspec

from zensim.vda5050 import order_errors
from zensim.vda5050.order_errors import ErrorKind, Rejection, VehicleError
from zensim.vda5050.order_progress import (
    OrderProgress,
    Status,
    VehicleFacts,
    accept,
    cancel,
    check_receiver,
    finish_actions,
    pass_node,
    step_actions,
)
from zensim.vda5050.vda_messages import (
    Action,
    InstantActions,
    Major,
    MalformedOrder,
    Order,
    OrderReference,
    read_message,
)
from zensim.vda5050.vehicle_settings import ActionSettings, BatterySettings, FleetSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

UNTIL_EVENT_S: Final = 1e12
"""Time of an action that something else ends."""
MAX_INSTANT: Final = 64
"""Instant actions that are reported, the newest."""
ORDER_ERRORS: Final = frozenset(
    {
        order_errors.INVALID,
        order_errors.UNKNOWN_ACTION,
        order_errors.OUTDATED,
        order_errors.SAME_ID,
        order_errors.AFTER_CANCEL,
        order_errors.BUSY,
        order_errors.START_TOO_FAR,
        order_errors.NO_ROUTE,
        order_errors.UNKNOWN_MAP,
        order_errors.NO_ORDER_TO_CANCEL,
        order_errors.ACTION_FAILED,
        order_errors.OFF_ROUTE,
    }
)
"""Errors that an accepted order ends."""


class InstantState(msgspec.Struct, frozen=True):
    """An instant action, and what became of it."""

    action: Action
    status: Status
    result: str = ""


class Cargo(Protocol):
    """Moves loads of the world."""

    def attach(self, vehicle: str, load: str) -> str:
        """Put an entity onto a vehicle; return why that is not possible, or nothing."""

    def detach(self, vehicle: str, load: str) -> str:
        """Put it down behind the vehicle; the same."""


class VehiclePose(NamedTuple):
    """Position [m] and heading [rad] in the map."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    @property
    def position(self) -> tuple[float, float]:
        """Position [m]."""
        return self.x, self.y


class VehicleRecord(msgspec.Struct, frozen=True):
    """What a vehicle keeps on disk."""

    progress: OrderProgress = OrderProgress()
    instant: tuple[InstantState, ...] = ()
    is_paused: bool = False
    charge: float = 100.0
    is_charging: bool = False
    load: str | None = None
    """Entity on the vehicle; empty = a load that is no entity; None = none."""


class Vehicle:
    """A vehicle; who calls it does what `needs_…` says, and clears that.

    Attributes:
        needs_state: A state is to be published.
        needs_route: The order has another route.
        needs_stop: The next node or stop is another one.
        needs_save: The record has changed.
        needs_factsheet: A factsheet was requested.
        is_manual: An operator commands the robot by `cmd_vel` during an order.
    """

    def __init__(
        self,
        name: str,
        *,
        major: Major,
        map_id: str,
        settings: FleetSettings,
        cargo: Cargo,
        serial: str = "",
    ) -> None:
        self.name, self.major, self.map_id, self._serial = name, major, map_id, serial
        self._settings, self._cargo = settings, cargo
        self._actions: Mapping[str, ActionSettings] = settings.all_actions
        self.errors: list[VehicleError] = []
        self.record = VehicleRecord(charge=settings.battery.at_start)
        self.needs_state = self.needs_route = self.needs_stop = True
        self.needs_save = self.needs_factsheet = self.is_manual = False

    @property
    def progress(self) -> OrderProgress:
        """The order and how far it is."""
        return self.record.progress

    @property
    def is_stuck(self) -> bool:
        """Whether an error does not let it drive."""
        return any(one.kind.level(self.major) in ("FATAL", "CRITICAL") for one in self.errors)

    @property
    def has_work(self) -> bool:
        """Whether an action begins or runs."""
        return any(one.is_triggered and not one.is_over for one in self.progress.actions) or any(
            one.status == "RUNNING" for one in self.record.instant
        )

    @property
    def is_waiting(self) -> bool:
        """Whether it must stand."""
        return self.record.is_paused or self.is_stuck or self.record.is_charging

    def restore(self, record: VehicleRecord) -> None:
        """Continue what was kept on disk."""
        self.record, self.needs_route, self.needs_state = record, True, True

    def take_over(self) -> None:
        """Pause the order until `stopPause`, as an operator commands the robot by `cmd_vel`."""
        if not (self.progress.is_idle or self.is_manual):
            self.is_manual = True
            self._change(is_paused=True)

    def take_order(self, payload: bytes, pose: VehiclePose) -> None:
        """Accept an order or an update, or report why not."""
        try:
            order = read_message(Order, payload)
        except MalformedOrder as error:
            self._reject_payload(payload, str(error))
            return
        facts = VehicleFacts(
            self.major,
            pose.position,
            self.map_id,
            self._actions,
            self._settings.start_tolerance_m,
            self._settings.manufacturer,
            self._serial,
        )
        try:
            found = accept(self.progress, order, facts)
        except Rejection as error:
            references = _refer(order.order_id, order.order_update_id, order.header_id)
            self.add_error(VehicleError(error.kind, str(error), references))
            return
        self.needs_state = True
        if found is not self.progress:
            self.errors = [one for one in self.errors if one.kind not in ORDER_ERRORS]
            self._change(progress=found)
            self.needs_route = True

    def take_instant_actions(self, payload: bytes, pose: VehiclePose) -> None:
        """Do instant actions, or report why not."""
        try:
            given = read_message(InstantActions, payload)
            problem = check_receiver(given, self._settings.manufacturer, self._serial)
        except MalformedOrder as error:
            given, problem = InstantActions(), str(error)
        if problem:
            references = (("topic", "instantActions"),)
            self.add_error(VehicleError(order_errors.INVALID, problem, references))
            return
        known = {one.action.action_id for one in self.record.instant}
        for action in given.actions + given.instant_actions:
            if action.action_id not in known:
                self._do_instant(action, pose)

    def add_error(self, error: VehicleError) -> None:
        """Report an error; an older one of the same kind goes."""
        if error not in self.errors:
            others = [one for one in self.errors if one.kind is not error.kind]
            self.errors = [*others, error]
            self.needs_state = True

    def clear_error(self, kind: ErrorKind) -> None:
        """Report an error no more."""
        left = [one for one in self.errors if one.kind is not kind]
        self.needs_state |= len(left) < len(self.errors)
        self.errors = left

    def traverse(self, pose: VehiclePose) -> None:
        """Traverse the next node."""
        self._change(progress=pass_node(self.progress, pose.position))
        self.needs_stop = True

    def step(self, dt_s: float, moved_m: float, *, is_still: bool) -> None:
        """Advance actions and battery by simulation time.

        Args:
            dt_s: Since the last call.
            moved_m: Way since then.
            is_still: Whether the vehicle stands.
        """
        self._drain(dt_s, moved_m)
        if self.progress.actions:
            before = self.progress
            after = step_actions(before, dt_s, self._start, self._finish)
            if after is not before:
                is_event = _list_statuses(after) != _list_statuses(before)
                self.record = msgspec.structs.replace(self.record, progress=after)
                if is_event:
                    self.needs_state = self.needs_save = self.needs_stop = True
        if is_still and any(one.status == "RUNNING" for one in self.record.instant):
            ended = tuple(
                msgspec.structs.replace(one, status="FINISHED") if one.status == "RUNNING" else one
                for one in self.record.instant
            )
            self._change(instant=ended)

    def _change(self, **fields: object) -> None:
        self.record = msgspec.structs.replace(self.record, **fields)
        self.needs_state = self.needs_save = True

    def _reject_payload(self, payload: bytes, text: str) -> None:
        try:
            known = read_message(OrderReference, payload)
        except MalformedOrder:
            known = OrderReference()
        references = _refer(known.order_id, known.order_update_id)
        self.add_error(VehicleError(order_errors.INVALID, text, references))

    def _do_instant(self, action: Action, pose: VehiclePose) -> None:
        doers: dict[str, Callable[[Action, VehiclePose], InstantState]] = {
            "cancelOrder": self._cancel,
            "startPause": self._pause,
            "stopPause": self._pause,
            "stateRequest": self._request,
            "factsheetRequest": self._request,
            "logReport": self._request,
            "initPosition": self._set_position,
            "initializePosition": self._set_position,
            "startCharging": self._plug,
            "stopCharging": self._plug,
            "trigger": self._trigger,
            "clearInstantActions": self._request,
        }
        doer = doers.get(action.action_type)
        if doer is None:
            known = ", ".join(sorted(doers))
            text = f"actionType {action.action_type!r} is unknown; use one of {known}"
            state = InstantState(action, "FAILED", text)
            self._report_instant(order_errors.INSTANT_ACTION, action, text)
        else:
            self.clear_error(order_errors.INSTANT_ACTION)
            state = doer(action, pose)
        kept = () if action.action_type == "clearInstantActions" else self.record.instant
        self._change(instant=(*kept, state)[-MAX_INSTANT:])

    def _report_instant(self, kind: ErrorKind, action: Action, text: str) -> None:
        references = (("topic", "instantActions"), ("actionId", action.action_id))
        self.add_error(VehicleError(kind, text, references))

    def _cancel(self, action: Action, _: VehiclePose) -> InstantState:
        wanted = action.read("orderId")
        if self.progress.is_idle or wanted not in ("", self.progress.order_id):
            text = f"order {(wanted or self.progress.order_id)!r} is not active"
            self._report_instant(order_errors.NO_ORDER_TO_CANCEL, action, text)
            return InstantState(action, "FAILED", text)
        self._change(progress=cancel(self.progress))
        self.clear_error(order_errors.OFF_ROUTE)
        self.needs_route = True
        return InstantState(action, "RUNNING")

    def _pause(self, action: Action, _: VehiclePose) -> InstantState:
        is_paused = action.action_type == "startPause"
        self.is_manual &= is_paused
        self._change(is_paused=is_paused)
        return InstantState(action, "RUNNING" if is_paused else "FINISHED")

    def _request(self, action: Action, _: VehiclePose) -> InstantState:
        self.needs_factsheet |= action.action_type == "factsheetRequest"
        return InstantState(action, "FINISHED")

    def _set_position(self, action: Action, pose: VehiclePose) -> InstantState:
        """Set the last node: a simulated vehicle knows where it is, so its pose must fit."""
        x, y = action.read_number("x"), action.read_number("y")
        if x is None or y is None or action.read("mapId") not in ("", self.map_id):
            text = f"x, y and mapId {self.map_id!r} are needed"
        elif ((x - pose.x) ** 2 + (y - pose.y) ** 2) ** 0.5 > self._settings.max_deviation_m:
            text = f"the vehicle is at {pose.x:.2f}, {pose.y:.2f}"
        else:
            last = action.read("lastNodeId") or self.progress.last_node_id
            found = msgspec.structs.replace(self.progress, last_node_id=last)
            self._change(progress=found)
            return InstantState(action, "FINISHED")
        self._report_instant(order_errors.INSTANT_ACTION, action, text)
        return InstantState(action, "FAILED", text)

    def _plug(self, action: Action, _: VehiclePose) -> InstantState:
        self._change(is_charging=action.action_type == "startCharging")
        return InstantState(action, "FINISHED")

    def _trigger(self, action: Action, _: VehiclePose) -> InstantState:
        self._change(progress=finish_actions(self.progress, "waitForTrigger"))
        return InstantState(action, "FINISHED")

    def _start(self, action: Action) -> float:
        known = self._actions.get(action.action_type, ActionSettings())
        if known.kind == "charge":
            self._change(is_charging=True)
        if known.kind in ("charge", "trigger"):
            return UNTIL_EVENT_S
        if known.kind != "wait" or not action.has("duration"):
            return known.duration_s
        return max(0.0, action.read_number("duration") or 0.0)

    def _finish(self, action: Action) -> str:
        kind = self._actions.get(action.action_type, ActionSettings()).kind
        problem = ""
        if kind in ("plug", "charge", "unplug"):
            self._change(is_charging=kind == "plug")
        elif kind == "attach":
            problem = self._attach(action.read("loadId"))
        elif kind == "detach":
            problem = self._detach()
        elif kind == "wait":
            problem = _check_duration(action)
        if problem:
            references = (("actionId", action.action_id),)
            self.add_error(VehicleError(order_errors.ACTION_FAILED, problem, references))
        return problem

    def _attach(self, load: str) -> str:
        if self.record.load is not None:
            return f"the vehicle has the load {self.record.load!r} already"
        problem = self._cargo.attach(self.name, load) if load else ""
        if not problem:
            self._change(load=load)
        return problem

    def _detach(self) -> str:
        load = self.record.load
        if load is None:
            return "the vehicle has no load"
        problem = self._cargo.detach(self.name, load) if load else ""
        if not problem:
            self._change(load=None)
        return problem

    def _drain(self, dt_s: float, moved_m: float) -> None:
        battery = self._settings.battery
        before = self.record.charge
        used = battery.per_hour * dt_s / 3600.0 + battery.per_km * moved_m / 1000.0
        gained = battery.charged_per_minute * dt_s / 60.0 if self.record.is_charging else 0.0
        charge = min(100.0, max(0.0, before + gained - used))
        self.record = msgspec.structs.replace(self.record, charge=charge)
        self.needs_save |= int(charge) != int(before)
        self._report_battery(battery, charge)
        if self.record.is_charging:
            self._end_charging(charge)

    def _report_battery(self, battery: BatterySettings, charge: float) -> None:
        for kind, is_so, text in (
            (order_errors.LOW_BATTERY, charge < battery.low, f"below {battery.low:g} %"),
            (order_errors.EMPTY_BATTERY, charge <= 0.0, "no charge left; send startCharging"),
        ):
            if is_so:
                self.add_error(VehicleError(kind, text))
            else:
                self.clear_error(kind)

    def _end_charging(self, charge: float) -> None:
        for one in self.progress.actions:
            known = self._actions.get(one.action.action_type)
            if one.status == "RUNNING" and known is not None and known.kind == "charge":
                if charge >= known.until_percent:
                    ended = finish_actions(self.progress, one.action.action_type)
                    self.record = msgspec.structs.replace(self.record, progress=ended)
                return
        if charge >= 100.0:  # noqa: PLR2004  percent
            self._change(is_charging=False)


def _refer(order_id: str, update_id: int, header_id: int = 0) -> tuple[tuple[str, str], ...]:
    found = (("topic", "order"), ("orderId", order_id), ("orderUpdateId", str(update_id)))
    return (*found, ("headerId", str(header_id)))


def _check_duration(action: Action) -> str:
    """Say what is wrong with the time of a wait; empty = nothing."""
    given = action.read_number("duration")
    if not action.has("duration") or (given is not None and given >= 0.0):
        return ""
    return f"duration {action.read('duration')[:80]!r} is no number of seconds >= 0"


def _list_statuses(progress: OrderProgress) -> list[tuple[Status, bool]]:
    return [(one.status, one.is_triggered) for one in progress.actions]
