"""Orders of VDA 5050 that vehicles of a scenario carry out, as `zensim vda5050` does; no broker."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_text_file
from zensim.scenario.scenario_format import CarryOutOrders
from zensim.vda5050.path_follower import VehicleLimits
from zensim.vda5050.vda_messages import Order
from zensim.vda5050.vehicle import Vehicle
from zensim.vda5050.vehicle_fleet import VehicleFleet
from zensim.vda5050.vehicle_settings import FleetSettings

FloatArray = npt.NDArray[np.float64]
START_S: Final = 1.0
"""Time of the fleet at the first step; 0 would be a fleet without one."""


class NoCargo:
    """Vehicles of scenarios move no loads."""

    def attach(self, _vehicle: str, load: str) -> str:
        """Refuse."""
        return f"scenarios move no loads, so {load!r} stays"

    detach = attach


def read_orders(file: Path, names: Sequence[str]) -> Mapping[str, Sequence[Order]]:
    """Read the orders of each robot, in the order of the file.

    Args:
        file: JSON: an order, or a list of orders; `serialNumber` is the robot, without one all are.
        names: Robots that may be named.

    Raises:
        OSError: It cannot be read.
        ValueError: It has no orders, or names an unknown robot.
    """
    try:
        found = msgspec.json.decode(
            read_text_file(file, MAX_OWN_FILE_BYTES), type=Order | list[Order]
        )
    except msgspec.MsgspecError as error:
        raise ValueError(f"no orders of VDA 5050: {error}") from None
    orders: dict[str, list[Order]] = {name: [] for name in names}
    for one in found if isinstance(found, list) else [found]:
        if one.serial_number and one.serial_number not in orders:
            raise ValueError(f"order {one.order_id!r}: there is no robot `{one.serial_number}`")
        for name in [one.serial_number] if one.serial_number else names:
            orders[name].append(one)
    return orders


class FleetOrders:
    """Motion of vehicles, which get an order when the one before is finished; updates at once."""

    def __init__(
        self,
        rows: npt.NDArray[np.intp],
        orders: Mapping[str, Sequence[Order]],
        behaviours: Sequence[CarryOutOrders],
    ) -> None:
        """Give no order yet.

        Args:
            rows: Of the robots in the state, (m,).
            orders: Of each robot, in the order of the rows.
            behaviours: Of each robot, (m,).
        """
        self._rows, self._names = rows, tuple(orders)
        self._places = {name: place for place, name in enumerate(self._names)}
        self._waiting = {name: list(listed) for name, listed in orders.items()}
        settings = FleetSettings()
        self._fleet = VehicleFleet(avoids=False, max_deviation_m=settings.max_deviation_m)
        for name, one in zip(self._names, behaviours, strict=True):
            limits = VehicleLimits(one.speed, settings.max_turn)
            self._fleet.add(_make_vehicle(name, orders[name], settings), limits)
        self._commands = np.zeros((len(rows), 2))

    def command(self, now: float, poses: FloatArray, twists: FloatArray) -> FloatArray:
        """Command speed [m/s] and turn [rad/s] of each vehicle, (m, 2).

        Args:
            now: Simulated time [s].
            poses: x, y [m] and heading [rad] of all robots, (n, 3).
            twists: Linear and angular velocity in the robots' frames, (n, 6).

        Raises:
            ValueError: A vehicle rejects an order, or cannot carry it out.
        """
        base = make_states(poses[self._rows], twists[self._rows])
        names, wanted = self._fleet.step(self._names, base, now + START_S)
        places = np.array([self._places[name] for name in names], dtype=np.intp)
        self._commands[places] = np.nan_to_num(wanted)[:, (0, 2)]
        for vehicle in self._fleet:
            self._give(vehicle)
        return self._commands

    def _give(self, vehicle: Vehicle) -> None:
        waiting, pose = self._waiting[vehicle.name], self._fleet.pose(vehicle.name)
        order = vehicle.progress.order_id
        if waiting and pose is not None and _may_follow(vehicle, waiting[0]):
            given = waiting.pop(0)
            order = given.order_id
            vehicle.take_order(msgspec.json.encode(given), pose)
        if vehicle.errors:
            first = vehicle.errors[0]
            raise ValueError(f"{vehicle.name}, order {order!r}: {first.kind.name(2)}: {first.text}")


def make_states(poses: FloatArray, twists: FloatArray) -> FloatArray:
    """Make states as in a snapshot (m, 13) of poses (m, 3) and twists (m, 6) in robots' frames."""
    base = np.zeros((len(poses), 13))
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    base[:, :2] = poses[:, :2]
    base[:, 5], base[:, 6] = np.sin(poses[:, 2] / 2.0), np.cos(poses[:, 2] / 2.0)
    base[:, 7] = twists[:, 0] * cosine - twists[:, 1] * sine
    base[:, 8] = twists[:, 0] * sine + twists[:, 1] * cosine
    base[:, 12] = twists[:, 5]
    return base


def _make_vehicle(name: str, orders: Sequence[Order], settings: FleetSettings) -> Vehicle:
    maps = [
        one.node_position.map_id
        for order in orders
        for one in order.nodes
        if one.node_position is not None
    ]
    map_id = maps[0] if maps else ""
    return Vehicle(name, major=2, map_id=map_id, settings=settings, cargo=NoCargo())


def _may_follow(vehicle: Vehicle, order: Order) -> bool:
    progress = vehicle.progress
    return progress.is_idle or order.order_id == progress.order_id
