"""All vehicles of a world: routes, stops and motion in arrays, one pass a snapshot; no network."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.rigid_transforms import find_yaw
from zensim.proto.se3 import FloatArray
from zensim.vda5050 import order_errors
from zensim.vda5050.footprint_check import CLEARANCE_M, Box, find_free_way
from zensim.vda5050.order_errors import ErrorKind, VehicleError
from zensim.vda5050.path_follower import (
    ALIGNED_RAD,
    BRAKING,
    REVERSE_RAD,
    RouteTable,
    VehicleLimits,
    follow,
)
from zensim.vda5050.route_geometry import make_route
from zensim.vda5050.vehicle import Vehicle, VehiclePose
from zensim.vda5050.vehicle_reports import VehicleMotion

STILL_M_S: Final = 0.02
STILL_S: Final = 0.2
"""Simulation time below that speed after which a vehicle stands; drives swing back once."""
MOVED_RAD: Final = 0.05
"""Turn that counts as motion, as does a way of `STILL_M_S` times `STANDS_S`."""
STANDS_S: Final = 1.0
"""Simulation time without motion after which a vehicle that should drive stands."""
NO_PROGRESS_S: Final = 5.0
"""The same until it reports that."""
IDLE_STEP_S: Final = 1.0
"""Simulation time between two steps of a vehicle without an action."""
LOOK_PERIOD_S: Final = 0.1
"""Simulation time between two looks at obstacles."""
LOOK_AHEAD_M: Final = 0.5
"""Looked at beyond the way to a stop."""
TOUCHED_S: Final = 1.0
"""Simulation time for which a contact is a violated field."""

ROW_ARRAYS: Final = (
    "_poses",
    "_twists",
    "_pending",
    "_s",
    "_free",
    "_touched_s",
    "_moved_s",
    "_progress_s",
    "_anchors",
    "_driving",
    "_violated",
    "_active",
)
"""Attributes with a row for each vehicle."""


class VehicleFleet:
    """The vehicles, a row each; a new one takes the row of one that was removed."""

    def __init__(self, *, avoids: bool, max_deviation_m: float) -> None:
        self._avoids, self._max_deviation_m = avoids, max_deviation_m
        self._table = RouteTable()
        self._row: dict[str, int] = {}
        self.vehicles: list[Vehicle | None] = []
        self._poses = np.zeros((0, 3))
        self._twists = np.zeros((0, 3))
        """Measured velocities in the base."""
        self._s = np.zeros(0)
        self._free = np.zeros(0)
        """Way before the next obstacle [m]."""
        self._pending = np.zeros((0, 2))
        """Simulation time and way since the last step of each vehicle."""
        self._touched_s = np.zeros(0)
        """Simulation time of the last contact."""
        self._moved_s = np.zeros(0)
        """Simulation time of the last motion."""
        self._progress_s = np.zeros(0)
        """Simulation time at which a vehicle left its anchor, or last had to stand."""
        self._anchors = np.zeros((0, 3))
        """Poses from which motion counts as progress."""
        self._driving = np.zeros(0, dtype=bool)
        self._violated = np.zeros(0, dtype=bool)
        self._active = np.zeros(0, dtype=bool)
        """Whether the vehicle has a twist of ours."""
        self._look_s = self._now_s = 0.0
        self._boxes: Mapping[str, Box] = {}
        self._known: tuple[tuple[str, ...], npt.NDArray[np.intp], FloatArray] | None = None

    def __iter__(self) -> Iterator[Vehicle]:
        return (one for one in self.vehicles if one is not None)

    def find(self, name: str) -> Vehicle | None:
        """Find a vehicle by the name of its robot."""
        row = self._row.get(name)
        return None if row is None else self.vehicles[row]

    def add(self, vehicle: Vehicle, limits: VehicleLimits) -> None:
        """Add a vehicle."""
        if None not in self.vehicles:
            self._add_row()
        row = self._row[vehicle.name] = self.vehicles.index(None)
        self.vehicles[row], self._known = vehicle, None
        for name in ROW_ARRAYS:
            getattr(self, name)[row] = 0
        self._free[row] = math.inf
        self._touched_s[row] = self._moved_s[row] = -math.inf
        self._poses[row] = math.nan
        self._table.clear_route(row)
        self._table.set_limits(row, limits)

    def _add_row(self) -> None:
        self.vehicles.append(None)
        self._table.resize(len(self.vehicles))
        for name in ROW_ARRAYS:
            old = getattr(self, name)
            more = np.zeros((1, *old.shape[1:]), dtype=old.dtype)
            setattr(self, name, np.concatenate([old, more]))

    def remove(self, name: str) -> None:
        """Remove a vehicle."""
        row = self._row.pop(name)
        self.vehicles[row] = None
        self._table.clear_route(row)
        self._active[row], self._known = False, None

    def set_boxes(self, boxes: Mapping[str, Box]) -> None:
        """Set the boxes of entities by name; those without one are no obstacles."""
        self._boxes, self._known = boxes, None

    def note_contact(self, name: str) -> None:
        """Note that a contact sensor of a vehicle touches something."""
        if (row := self._row.get(name)) is not None:
            self._touched_s[row] = self._now_s

    def pose(self, name: str) -> VehiclePose | None:
        """Return where a vehicle is; None while that is not known."""
        found = self._poses[self._row[name]].tolist()
        return None if math.isnan(found[0]) else VehiclePose(*found)

    def find_route(self, name: str) -> FloatArray:
        """Find the points from a vehicle to the end of its route [m], (k, 2); without one, none."""
        row, table = self._row[name], self._table
        last = int(table.last[row])
        if last == 0:
            return np.zeros((0, 2))
        ahead = slice(int(table.cursor[row]) + 1, last + 1)
        return np.vstack([self._poses[row, :2], np.stack([table.x[row], table.y[row]], 1)[ahead]])

    def motion(self, name: str) -> VehicleMotion | None:
        """Return how a vehicle moves; None while its pose is not known."""
        if (pose := self.pose(name)) is None:
            return None
        row = self._row[name]
        forward, left, turn = self._twists[row].tolist()
        way = float(self._s[row] - self._start_of_edge(row))
        driving, violated = bool(self._driving[row]), bool(self._violated[row])
        return VehicleMotion(pose, forward, left, turn, driving, max(0.0, way), violated)

    def step(
        self, names: tuple[str, ...], base: FloatArray, now_s: float
    ) -> tuple[Sequence[str], FloatArray]:
        """Advance all vehicles to a snapshot.

        Args:
            names: All entities.
            base: Their states as in a snapshot, (m, 13).
            now_s: Simulation time [s]; earlier than before = the world was reset.

        Returns:
            Names of robots, and the twist of each (k, 3); NaN = it is released.
        """
        dt_s = max(0.0, now_s - self._now_s) if self._now_s else 0.0
        self._now_s, self._look_s = now_s, min(self._look_s, now_s + LOOK_PERIOD_S)
        for times in (self._touched_s, self._moved_s, self._progress_s):
            np.minimum(times, now_s, out=times)
        at, boxes = self._find_rows(names)
        before = self._poses
        self._measure(base, at)
        self._set_routes()
        if dt_s <= 0.0:
            return (), np.zeros((0, 3))
        if self._avoids and now_s >= self._look_s:
            self._look_s = now_s + LOOK_PERIOD_S
            self._look(base, boxes, at)
        twists = self._follow(dt_s)
        moved = np.nan_to_num(np.hypot(*(self._poses - before)[:, :2].T))
        self._pending += np.stack([np.full(len(moved), dt_s), moved], axis=1)
        self._step_vehicles()
        return self._choose(twists)

    def _find_rows(self, names: tuple[str, ...]) -> tuple[npt.NDArray[np.intp], FloatArray]:
        """Find the row of each vehicle in a snapshot, -1 = none, and the boxes of all entities."""
        if self._known is None or self._known[0] != names:
            rows = {name: at for at, name in enumerate(names)}
            at = [rows.get(one.name, -1) if one is not None else -1 for one in self.vehicles]
            nothing = (math.nan,) * len(Box._fields)
            boxes = np.array([self._boxes.get(name, nothing) for name in names], dtype=float)
            self._known = names, np.array(at, dtype=np.intp), boxes.reshape(-1, len(Box._fields))
        return self._known[1], self._known[2]

    def _measure(self, base: FloatArray, at: npt.NDArray[np.intp]) -> None:
        """Take poses and twists of the vehicles from a snapshot."""
        states = base[at] if len(base) else np.zeros((len(at), 13))
        states = np.where((at >= 0)[:, None], states, math.nan)
        yaw = find_yaw(tuple(states[:, 3:7].T), ARRAY_MATH)
        cosine, sine = np.cos(yaw), np.sin(yaw)
        vx, vy = states[:, 7], states[:, 8]
        self._poses = np.stack([states[:, 0], states[:, 1], yaw], axis=1)
        moving = [vx * cosine + vy * sine, vy * cosine - vx * sine, states[:, 12]]
        self._twists = np.nan_to_num(np.stack(moving, axis=1))

    def _set_routes(self) -> None:
        for row, vehicle in enumerate(self.vehicles):
            if vehicle is None or math.isnan(self._poses[row, 0]):
                continue
            if vehicle.needs_route:
                vehicle.needs_route, vehicle.needs_stop = False, True
                self._set_route(row, vehicle)
            if vehicle.needs_stop:
                vehicle.needs_stop = False
                self._set_stop(row, vehicle)

    def _set_route(self, row: int, vehicle: Vehicle) -> None:
        progress, limits = vehicle.progress, self._table.limits[row]
        count = progress.base
        if not count:
            self._table.clear_route(row)
            return
        route = make_route(
            progress.origin,
            progress.nodes[:count],
            progress.edges[:count],
            max_speed=limits[0],
            deceleration=BRAKING * limits[3],
        )
        x, y, _ = self._poses[row].tolist()
        self._table.set_route(row, route, (x, y))

    def _set_stop(self, row: int, vehicle: Vehicle) -> None:
        """Set the way to the next node and to the next stop."""
        progress, table = vehicle.progress, self._table
        nodes = table.nodes.get(row, np.zeros(0))
        count, base = progress.find_stop(), progress.base
        begin = len(nodes) - base
        table.stop_heading[row] = math.nan
        if not base or not count:
            table.node_s[row] = math.inf
            table.stop_s[row] = nodes[begin - 1] if 0 < begin <= len(nodes) else 0.0
            if not base:
                table.clear_route(row)
            return
        table.node_s[row], table.stop_s[row] = nodes[begin], nodes[begin + count - 1]
        place = progress.nodes[count - 1].node_position
        if place is not None and place.theta is not None:
            table.stop_heading[row] = place.theta
            given = place.allowed_deviation_theta
            table.aligned[row] = max(abs(given), 0.01) if given else ALIGNED_RAD

    def _start_of_edge(self, row: int) -> float:
        vehicle, nodes = self.vehicles[row], self._table.nodes.get(row)
        if vehicle is None or nodes is None or self._table.last[row] == 0:
            return float(self._s[row])
        begin = len(nodes) - vehicle.progress.base
        return float(nodes[begin - 1]) if begin > 0 else 0.0

    def _look(self, base: FloatArray, boxes: FloatArray, at: npt.NDArray[np.intp]) -> None:
        movers = np.flatnonzero((self._table.last > 0) & (at >= 0))
        self._free[:] = math.inf
        if not len(movers):
            return
        yaw = find_yaw(tuple(base[:, 3:7].T), ARRAY_MATH)
        places = np.column_stack([base[:, :3], yaw])
        table, driven = self._table, self._table.driven[movers]
        turn = table.turn[movers, table.cursor[movers]]
        braking = driven**2 / (2.0 * BRAKING * table.limits[movers, 3])
        aim = self._poses[movers, 2] + np.where(np.abs(turn) > REVERSE_RAD, math.pi, 0.0)
        is_sideways = (table.limits[movers, 5] > 0.0) & (driven > STILL_M_S)
        velocity = self._twists[movers]
        aim += np.where(is_sideways, np.arctan2(velocity[:, 1], velocity[:, 0]), 0.0)
        reach = braking + CLEARANCE_M + LOOK_AHEAD_M
        # A vehicle does not look beyond its stop.
        left = np.maximum(table.stop_s[movers] - self._s[movers], 0.0)
        travel = np.column_stack([aim, np.minimum(reach, left + CLEARANCE_M)])
        self._free[movers] = find_free_way(places, boxes, at[movers], travel)

    def _follow(self, dt_s: float) -> FloatArray:
        """Find twists; note where vehicles are, and let them traverse nodes."""
        table = self._table
        waits = [one is None or one.is_waiting or one.progress.is_held for one in self.vehicles]
        known = ~np.isnan(self._poses[:, 0])
        slowing = 2.0 * BRAKING * table.limits[:, 3]
        gate = np.sqrt(slowing * np.maximum(self._free - CLEARANCE_M, 0.0))
        gate = np.where(np.array(waits, dtype=bool) | ~known, 0.0, gate)
        twists, progress = follow(table, np.nan_to_num(self._poses), dt_s, gate)
        self._s = progress.s
        has_route = table.last > 0
        is_off = has_route & known & (progress.off > self._max_deviation_m)
        text = f"the vehicle is more than {self._max_deviation_m:g} m from its route"
        self._report(is_off, order_errors.OFF_ROUTE, text)
        arrived = progress.arrived & (table.node_s <= table.stop_s + 1e-6)
        for row in np.flatnonzero((progress.passed | arrived) & known & ~is_off).tolist():
            self._traverse(row)
        # Turning on the spot is driving, too; before an obstacle a vehicle may creep.
        is_sent = (np.abs(twists).max(axis=1, initial=0.0) > 0.0) & (gate > STILL_M_S)
        self._note_motion(is_sent & known)
        return twists

    def _note_motion(self, is_sent: npt.NDArray[np.bool_]) -> None:
        """Note which vehicles drive, and report those that are sent on and stand."""
        way = np.abs(self._poses - self._anchors)
        turn = np.minimum(way[:, 2], 2.0 * math.pi - way[:, 2])
        has_moved = (np.hypot(*way[:, :2].T) > STILL_M_S * STANDS_S) | (turn > MOVED_RAD)
        is_new = has_moved | ~is_sent
        self._anchors[is_new], self._progress_s[is_new] = self._poses[is_new], self._now_s
        stood_s = self._now_s - self._progress_s
        text = f"the vehicle should drive, and stands for {NO_PROGRESS_S:g} s; free its way"
        self._report(stood_s >= NO_PROGRESS_S, order_errors.NO_PROGRESS, text)
        speed = np.hypot(self._twists[:, 0], self._twists[:, 1])
        moving = ((speed > STILL_M_S) | is_sent) & (stood_s < STANDS_S)
        self._moved_s[moving] = self._now_s
        driving = self._now_s - self._moved_s < STILL_S
        violated = (self._free < CLEARANCE_M) | (self._now_s - self._touched_s < TOUCHED_S)
        for row in np.flatnonzero((driving != self._driving) | (violated != self._violated)):
            if (changed := self.vehicles[row]) is not None:
                changed.needs_state = True
        self._driving, self._violated = driving, violated

    def _report(self, rows: npt.NDArray[np.bool_], kind: ErrorKind, text: str) -> None:
        """Report an error of vehicles that do not get to their next node, until it is over."""
        for vehicle in self:
            if vehicle.errors and not rows[self._row[vehicle.name]]:
                vehicle.clear_error(kind)
        for row in np.flatnonzero(rows).tolist():
            if (vehicle := self.vehicles[row]) is not None and vehicle.progress.nodes:
                references = (("nodeId", vehicle.progress.nodes[0].node_id),)
                vehicle.add_error(VehicleError(kind, text, references))

    def _traverse(self, row: int) -> None:
        vehicle = self.vehicles[row]
        if vehicle is not None and vehicle.progress.base:
            vehicle.traverse(VehiclePose(*self._poses[row].tolist()))
            vehicle.needs_stop = False
            self._set_stop(row, vehicle)

    def _step_vehicles(self) -> None:
        """Step vehicles with actions now, and the others from time to time."""
        is_due = self._pending[:, 0] >= IDLE_STEP_S
        for row, vehicle in enumerate(self.vehicles):
            if vehicle is not None and (is_due[row] or vehicle.has_work):
                dt_s, moved_m = self._pending[row].tolist()
                self._pending[row] = 0.0
                vehicle.step(dt_s, moved_m, is_still=not self._driving[row])

    def _choose(self, twists: FloatArray) -> tuple[Sequence[str], FloatArray]:
        """Choose the vehicles that are commanded, and those that are released now."""
        active = np.array(
            [
                one is not None and not (one.progress.is_idle or one.is_manual)
                for one in self.vehicles
            ],
            dtype=bool,
        )
        # A vehicle is released after its order, or for who drives it by hand, when it stands.
        still = ~self._driving
        rows = np.flatnonzero(active | self._active)
        twists[~active & still] = math.nan
        self._active = active | (self._active & ~still)
        names = [one.name for row in rows if (one := self.vehicles[row]) is not None]
        return names, twists[rows]
