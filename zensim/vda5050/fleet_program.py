"""The program: robots of a world on one side, an MQTT broker on the other."""

import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from fnmatch import fnmatchcase
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import STATE_COLUMNS, TwistCommands, split_orders
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse, Snapshot
from zensim.proto.messages.vehicle_messages import FleetStatus
from zensim.proto.se3 import FloatArray
from zensim.proto.topic_catalog import CMD_VEL, SNAPSHOT, TWISTS, VEHICLES
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.client.topic_reader import read_topic
from zensim.spawner.client.world_follower import FAILURES, WorldFollower
from zensim.vda5050 import order_errors
from zensim.vda5050.broker_links import BrokerLinks
from zensim.vda5050.carried_loads import CarriedLoads
from zensim.vda5050.factsheet import make_factsheet
from zensim.vda5050.footprint_check import Box, make_box
from zensim.vda5050.order_errors import VehicleError
from zensim.vda5050.record_store import RecordStore
from zensim.vda5050.vda_messages import Major
from zensim.vda5050.vehicle import Vehicle
from zensim.vda5050.vehicle_fleet import VehicleFleet
from zensim.vda5050.vehicle_models import describe_vehicle
from zensim.vda5050.vehicle_reports import (
    MIN_STATE_PERIOD_S,
    STATE_PERIOD_S,
    VehicleBody,
    report_state,
    report_status,
    report_visualization,
)
from zensim.vda5050.vehicle_settings import FleetSettings

POLL_S: Final = 0.01
SILENCE_S: Final = 2.0
"""Wall time without a snapshot after which vehicles do not know where they are."""
CALL_TIMEOUT_S: Final = 2.0
SNAPSHOT_DEPTH: Final = 4
MANUAL_DEPTH: Final = 256
"""Commands of people that wait, of all robots."""


class ServedFleet(NamedTuple):
    """What the program serves."""

    world: str
    major: Major
    pattern: str
    """Names of robots, with * and ?."""
    avoids: bool
    settings: FleetSettings


class _Served(NamedTuple):
    """What is published of a vehicle besides its state."""

    serial: str
    body: VehicleBody


class FleetProgram:
    """Vehicles of one world; `run` returns when it is told to stop."""

    def __init__(
        self, bus: Bus, links: BrokerLinks, store: RecordStore, options: ServedFleet
    ) -> None:
        """Subscribe.

        Args:
            bus: Open session.
            links: Connections to the broker; closed with the program.
            store: Records of vehicles; closed with the program.
            options: What to serve.
        """
        self._bus, self._links, self._store, self._options = bus, links, store, options
        world, settings = options.world, options.settings
        self._client = ServiceClient(bus, world, CALL_TIMEOUT_S)
        self._follower = WorldFollower(bus, world)
        self._snapshots = read_topic(bus, SNAPSHOT.key(world), Snapshot, SNAPSHOT_DEPTH)
        self._twists = bus.advertise(TWISTS.key(world), TWISTS.encoding)
        self._manual = bus.subscribe(f"**/{CMD_VEL.name}", MANUAL_DEPTH)
        self._statuses = bus.advertise(VEHICLES.key(world), VEHICLES.encoding)
        self._status_due_s = 0.0
        self._name = f"vda5050-{uuid.uuid4().hex[:12]}"
        self._token = bus.token(keys.alive_client(world, self._name))
        self._fleet = VehicleFleet(avoids=options.avoids, max_deviation_m=settings.max_deviation_m)
        self._worker = ThreadPoolExecutor(1, "vda5050")
        self._loads = CarriedLoads(self._client, self._worker)
        self._fetched: Future[tuple[GetModelsResponse, dict[int, Box]] | None] | None = None
        self._boxes: dict[int, Box] = {}
        self._served: dict[str, _Served] = {}
        self._names: dict[str, str] = {}
        """Names of robots by serial number."""
        self._by_key: dict[str, str] = {}
        """Names of robots by the key of their `cmd_vel`."""
        self._due: dict[str, tuple[float, float, float]] = {}
        """Wall time of earliest and latest next state and of the next visualization, by robot."""

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Serve the vehicles."""
        try:
            while not should_stop():
                self._turn()
        finally:
            self._worker.shutdown(cancel_futures=True)
            self._links.close()
            self._store.close()
            self._token.close()
            self._follower.close()
            self._snapshots.close()
            self._manual.close()
            self._twists.close()
            self._statuses.close()

    def _turn(self) -> None:
        self._follow_world()
        for message in self._links.poll(POLL_S):
            self._take(self._names.get(message.serial, ""), message.topic, message.payload)
        for sample in self._manual.take():
            if (vehicle := self._fleet.find(self._by_key.get(sample.key, ""))) is not None:
                vehicle.take_over()
        self._take_snapshot()
        # What a state says must outlive this process, so it is saved first.
        self._save()
        self._publish()
        self._publish_statuses()

    def _take(self, name: str, topic: str, payload: bytes) -> None:
        vehicle = self._fleet.find(name)
        pose = self._fleet.pose(name) if vehicle is not None else None
        if vehicle is None or pose is None:
            return
        if topic == "order":
            vehicle.take_order(payload, pose)
        elif topic == "instantActions":
            vehicle.take_instant_actions(payload, pose)

    def _take_snapshot(self) -> None:
        snapshot = self._snapshots.newest()
        if snapshot is None:
            if self._snapshots.is_silent(SILENCE_S):
                for vehicle in self._fleet:
                    text = f"the server of world '{self._options.world}' is silent"
                    vehicle.add_error(VehicleError(order_errors.LOST, text))
            return
        try:
            base = np.frombuffer(snapshot.base, dtype="<f8").reshape(-1, STATE_COLUMNS)
        except ValueError:
            return
        if len(base) == len(snapshot.names):
            self._step(snapshot, base)

    def _step(self, snapshot: Snapshot, base: FloatArray) -> None:
        for vehicle in self._fleet:
            if vehicle.errors:
                vehicle.clear_error(order_errors.LOST)
        self._follower.note_roster(snapshot.roster)
        now_s = snapshot.time_ns / NANOSECONDS
        names, twists = self._fleet.step(snapshot.names, base, now_s)
        self._loads.step(snapshot.names, base)
        if len(names):
            whole = TwistCommands(self._name, tuple(names), twists.astype("<f8").tobytes())
            for part in split_orders(whole):
                self._twists.send(encode(part, Format.MSGPACK))

    def _save(self) -> None:
        changed = [one for one in self._fleet if one.needs_save]
        for vehicle in changed:
            vehicle.needs_save = False
        self._store.save({one.name: one.record for one in changed})

    def _publish(self) -> None:
        for serial in self._links.take_connected():
            if (vehicle := self._fleet.find(self._names.get(serial, ""))) is not None:
                vehicle.needs_state = vehicle.needs_factsheet = True
        now_s = time.monotonic()
        for vehicle in self._fleet:
            earliest_s, latest_s, drawn_s = self._due[vehicle.name]
            has_state = now_s >= latest_s or (vehicle.needs_state and now_s >= earliest_s)
            if has_state or vehicle.needs_factsheet or now_s >= drawn_s:
                self._publish_vehicle(vehicle, now_s, has_state=has_state)

    def _publish_vehicle(self, vehicle: Vehicle, now_s: float, *, has_state: bool) -> None:
        serial, body = self._served[vehicle.name]
        motion = self._fleet.motion(vehicle.name)
        if motion is None or not self._links.is_ready(serial):
            return
        earliest_s, latest_s, drawn_s = self._due[vehicle.name]
        settings = self._options.settings
        if vehicle.needs_factsheet:
            vehicle.needs_factsheet = False
            sheet = make_factsheet(vehicle.major, body, settings)
            self._links.publish(serial, "factsheet", sheet)
        if has_state:
            vehicle.needs_state = False
            earliest_s, latest_s = now_s + MIN_STATE_PERIOD_S, now_s + STATE_PERIOD_S
            self._links.publish(serial, "state", report_state(vehicle, motion))
        if now_s >= drawn_s:
            drawn_s = max(drawn_s, now_s - 1.0) + 1.0 / settings.visualization_hz
            drawing = report_visualization(vehicle, motion, self._links.count(serial, "state"))
            self._links.publish(serial, "visualization", drawing)
        self._due[vehicle.name] = earliest_s, latest_s, drawn_s

    def _publish_statuses(self) -> None:
        """Tell the page and other tools, once a second, if there are any."""
        now_s = time.monotonic()
        if now_s < self._status_due_s or not self._statuses.is_matched:
            return
        self._status_due_s = now_s + 1.0 / VEHICLES.rate_hz
        found = tuple(
            report_status(one, motion, self._fleet.find_route(one.name))
            for one in self._fleet
            if (motion := self._fleet.motion(one.name)) is not None
        )
        self._statuses.send(encode(FleetStatus(found), Format.MSGPACK))

    def _follow_world(self) -> None:
        for event in self._follower.take().events:
            if event.kind == "touched":
                self._fleet.note_contact(event.entity)
        if self._fetched is not None and self._fetched.done():
            found, self._fetched = self._fetched.result(), None
            if found is not None:
                models, self._boxes = found
                self._follower.accept(models)
                self._set_vehicles(models)
        if self._fetched is None and (fetch := self._follower.take_fetch()) is not None:
            self._fetched = self._worker.submit(partial(self._fetch, fetch))

    def _fetch(
        self, fetch: Callable[[], GetModelsResponse | None]
    ) -> tuple[GetModelsResponse, dict[int, Box]] | None:
        """Get the models, and the bounds of one entity of each; in the thread of the worker."""
        if (models := fetch()) is None:
            return None
        firsts = {one.model: one.entity for one in reversed(models.entities)}
        boxes: dict[int, Box] = {}
        for number, entity in firsts.items():
            with suppress(*FAILURES):
                if (box := make_box(self._client.entity_bounds(entity))) is not None:
                    boxes[number] = box
        return models, boxes

    def _set_vehicles(self, models: GetModelsResponse) -> None:
        """Add and remove vehicles as robots come and go."""
        robots = {one.entity: one for one in self._list_robots(models)}
        for name in [one.name for one in self._fleet if one.name not in robots]:
            self._links.remove(self._served.pop(name).serial)
            self._fleet.remove(name)
        for name, robot in robots.items():
            if name not in self._served:
                self._add(robot, models)
        self._by_key = {CMD_VEL.key(one.namespace): name for name, one in robots.items()}
        boxes = {one.entity: self._boxes.get(one.model) for one in models.entities}
        found = {name: box for name, box in boxes.items() if box is not None}
        self._loads.set_boxes(found, frozenset(robots))
        self._fleet.set_boxes(found)

    def _list_robots(self, models: GetModelsResponse) -> Iterator[EntityModel]:
        for one in models.entities:
            is_robot = models.models[one.model].drive is not None
            if is_robot and fnmatchcase(one.entity, self._options.pattern):
                yield one

    def _add(self, robot: EntityModel, models: GetModelsResponse) -> None:
        options, name = self._options, robot.entity
        serial = make_serial(name)
        body = describe_vehicle(
            models.models[robot.model], self._boxes.get(robot.model, Box()), options.settings
        )
        vehicle = Vehicle(
            name,
            major=options.major,
            map_id=options.settings.map_id or options.world,
            settings=options.settings,
            cargo=self._loads,
            serial=serial,
        )
        if (record := self._store.load(name)) is not None:
            vehicle.restore(record)
            self._loads.restore(name, record.load)
        self._served[name], self._names[serial] = _Served(serial, body), name
        rate_hz = options.settings.visualization_hz
        shown_s = time.monotonic() + len(self._due) % 97 / 97.0 if rate_hz else float("inf")
        self._due[name] = 0.0, 0.0, shown_s
        self._fleet.add(vehicle, body.limits)
        self._links.add(serial)


def make_serial(name: str) -> str:
    """Make the serial number of a robot: other characters than the standard's become `_`."""
    return "".join(
        one if one.isascii() and (one.isalnum() or one in "_.:-") else "_" for one in name
    )
