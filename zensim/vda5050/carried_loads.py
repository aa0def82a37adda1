"""Entities on vehicles: put onto them, moved along, put down; by `set_entity_state`."""

import math
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from concurrent.futures import Executor, Future
from contextlib import suppress
from typing import Final

from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion
from zensim.proto.rigid_transforms import from_rpy, to_rpy
from zensim.proto.se3 import FloatArray
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.client.world_follower import FAILURES
from zensim.vda5050.footprint_check import Box

REACH_M: Final = 3.0
"""Distance of a load that can be picked."""
GAP_M: Final = 0.02
SLACK_M: Final = 0.02
"""Way that a vehicle moves before its load is moved along."""


class CarriedLoads:
    """The loads of all vehicles."""

    def __init__(self, client: ServiceClient, worker: Executor) -> None:
        self._client, self._worker = client, worker
        self._boxes: Mapping[str, Box] = {}
        self._robots: AbstractSet[str] = frozenset()
        self._loads: dict[str, str] = {}
        """Entity on each vehicle that has one."""
        self._placed: dict[str, tuple[float, float, float]] = {}
        self._states: dict[str, FloatArray] = {}
        self._moving: Future[None] | None = None

    def set_boxes(self, boxes: Mapping[str, Box], robots: AbstractSet[str]) -> None:
        """Set the boxes of all entities, and which of them are vehicles."""
        self._boxes, self._robots = boxes, robots

    def restore(self, vehicle: str, load: str | None) -> None:
        """Continue to carry what a vehicle had."""
        if load:
            self._loads[vehicle] = load

    def attach(self, vehicle: str, load: str) -> str:
        """See `Cargo`."""
        own, other = self._states.get(vehicle), self._states.get(load)
        if own is None or other is None or load in self._robots or load not in self._boxes:
            return f"loadId {load!r} is no entity that can be picked"
        if load in self._loads.values():
            return f"loadId {load!r} is on another vehicle"
        distance = math.hypot(other[0] - own[0], other[1] - own[1])
        if distance > REACH_M:
            return f"loadId {load!r} is {distance:.1f} m away, and {REACH_M:g} m are reached"
        self._loads[vehicle] = load
        return ""

    def detach(self, vehicle: str, load: str) -> str:
        """See `Cargo`."""
        if self._loads.pop(vehicle, None) is None:
            return ""
        self._placed.pop(vehicle, None)
        own, body, box = self._states.get(vehicle), self._boxes.get(vehicle), self._boxes.get(load)
        if own is None or body is None or box is None:
            return f"loadId {load!r} is gone"
        back = body.x - body.half_length - box.half_length - 0.1
        floor = float(own[2]) + body.bottom
        self._worker.submit(
            self._move, {load: _place(own, back - box.x, floor - box.bottom + GAP_M)}
        )
        return ""

    def step(self, names: tuple[str, ...], base: FloatArray) -> None:
        """Move loads along with their vehicles."""
        self._states = dict(zip(names, base, strict=True))
        if not self._loads or (self._moving is not None and not self._moving.done()):
            return
        poses: dict[str, Pose] = {}
        for vehicle, load in self._loads.items():
            own, body = self._states.get(vehicle), self._boxes.get(vehicle)
            box = self._boxes.get(load)
            if own is not None and body is not None and box is not None:
                place = (float(own[0]), float(own[1]), float(own[5]))
                if math.dist(place, self._placed.get(vehicle, (math.inf,) * 3)) > SLACK_M:
                    self._placed[vehicle] = place
                    top = float(own[2]) + body.top - box.bottom + GAP_M
                    poses[load] = _place(own, body.x - box.x, top)
        if poses:
            self._moving = self._worker.submit(self._move, poses)

    def _move(self, poses: Mapping[str, Pose]) -> None:
        for load, pose in poses.items():
            with suppress(*FAILURES):
                self._client.set_entity_state(load, EntityState(pose=pose))


def _place(own: FloatArray, ahead: float, z: float) -> Pose:
    """Make a pose ahead of the base of a vehicle, at a height [m]."""
    x, y = own[:2].tolist()
    yaw = to_rpy(tuple(own[3:7].tolist()))[2]
    place = Point(x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), z)
    return Pose(place, Quaternion(*from_rpy(0.0, 0.0, yaw)))
