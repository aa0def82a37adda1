"""A server in memory that has models and publishes scene states by order of a test."""

import msgspec
import numpy as np

from tests.fakes import ManualClock, MemoryBus
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.memory_bus import MemorySubscription
from zensim.proto.messages.asset_messages import GetAssetRequest, GetAssetResponse
from zensim.proto.messages.model_messages import Link, Model, Origin, Sensor, Shape
from zensim.proto.messages.sensing_messages import Environment, SceneState
from zensim.proto.messages.sensor_messages import Noise, RaySensor, ScanAxis, SensorTopic
from zensim.proto.messages.standard_messages import LaserScan
from zensim.proto.messages.telemetry_messages import EntityModel, Event, GetModelsResponse
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.se3 import FloatArray, from_rpy
from zensim.proto.topic_catalog import EVENTS, SCENE_STATE
from zensim.sim_server.sensors.sensor_config import SensorProcessConfig
from zensim.sim_server.sensors.sensor_process import SensorProcess

WORLD = "default"
STEP_NS = 4_166_667
CONTROL_STEPS = 3
ENVIRONMENT = Environment(seed=3, step_ns=STEP_NS, control_steps=CONTROL_STEPS, has_ground=False)
NOISE = Noise("gaussian", stddev=0.01)
QUARTERS = ScanAxis(4, 0.0, 1.5 * np.pi)
"""Rays to the front, left, back and right."""


def a_lidar(name: str = "lidar", rate_hz: float = 10.0, **settings: object) -> Sensor:
    """A lidar in the middle of its robot."""
    ray = RaySensor(QUARTERS, range_min_m=0.1, range_max_m=20.0)
    topic = "scan" if name == "lidar" else f"{name}/scan"
    return Sensor(
        name,
        "ray",
        "base",
        "base",
        update_rate_hz=rate_hz,
        settings=msgspec.structs.replace(ray, **settings),
        topics=(SensorTopic("scan", topic),),
        frame_id="base",
    )


def a_robot(*sensors: Sensor) -> Model:
    """A cube of 0.2 m."""
    cube = Shape("box", (0.2, 0.2, 0.2))
    return Model("robot", (Link("base", collisions=(cube,)),), sensors=sensors or (a_lidar(),))


def a_wall(x: float) -> Model:
    """A wall across x whose front is at x."""
    wall = Shape("box", (1.0, 50.0, 5.0), Origin((x + 0.5, 0.0, 0.0)))
    return Model("wall", (Link("base", collisions=(wall,)),), is_static=True)


def at(x: float, y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    return np.concatenate([[x, y, 0.0], from_rpy(0.0, 0.0, yaw)])


class SensedWorld:
    """Entities, and the processes that sense them."""

    def __init__(self) -> None:
        self.bus = MemoryBus()
        self.clock = ManualClock(100.0)
        self.environment = ENVIRONMENT
        self.models: dict[str, Model] = {}
        self.poses: dict[str, FloatArray] = {}
        self.assets: dict[str, bytes] = {}
        self.roster = 1
        self.joints = 0
        """Of all entities, at 0."""
        self.requests: list[str] = []
        self.processes: dict[str, SensorProcess] = {}
        self._calls = self.bus.serve(keys.services(WORLD))
        self.bus.pumps.append(self._serve)
        self.bus.token(keys.alive_server(WORLD))

    def spawn(self, name: str, model: Model, pose: FloatArray) -> None:
        self.models[name], self.poses[name] = model, pose
        self.roster += 1
        event = Event("spawned", name)
        self.bus.put_message(EVENTS.key(WORLD), event, Format.MSGPACK)

    def delete(self, name: str) -> None:
        del self.models[name], self.poses[name]
        self.roster += 1
        self.bus.put_message(EVENTS.key(WORLD), Event("deleted", name), Format.MSGPACK)

    def start(
        self, name: str, *, is_always_on: bool = False, ros: RosSettings = NO_ROS
    ) -> SensorProcess:
        """Start a sensor process, and let it find its share."""
        given = SensorProcessConfig(
            endpoint="", world=WORLD, name=name, is_always_on=is_always_on, ros=ros
        )
        self.processes[name] = SensorProcess(self.bus, given)
        self.run(0.3)
        return self.processes[name]

    def kill(self, name: str) -> None:
        """End a process; its tokens disappear."""
        self.processes.pop(name).close()

    def listen(self, key: str) -> MemorySubscription:
        """Subscribe, and let the processes become active."""
        heard = self.bus.subscribe(key, 1000)
        self.run(0.3)
        return heard

    def run(self, seconds: float) -> None:
        """Poll all processes for a wall time."""
        end_s = self.clock() + seconds
        while self.clock() < end_s:
            for process in self.processes.values():
                process.poll(self.clock())
            self.clock.sleep(0.01)

    def publish(self, step: int, *, epoch: int = 0, is_awaited: bool = False) -> None:
        """Publish the scene state of a step, as a server does."""
        base = np.array(list(self.poses.values()))
        state = SceneState(
            epoch,
            step,
            step * STEP_NS,
            self.roster,
            base.tobytes(),
            np.zeros(self.joints).tobytes(),
            self.list_active(),
            is_awaited,
        )
        self.bus.put_message(SCENE_STATE.key(WORLD), state, Format.MSGPACK)

    def step_to(self, step: int, *, epoch: int = 0) -> None:
        """Publish a scene state, and let the processes handle it."""
        self.publish(step, epoch=epoch)
        self.run(0.03)

    def list_active(self) -> tuple[str, ...]:
        tokens = self.bus.list_tokens(keys.active_sensors(WORLD, "*"))
        return tuple(sorted(keys.parse_sensor_process(token) for token in tokens))

    def _serve(self) -> None:
        for call in self._calls.take():
            self.requests.append(call.name)
            response = self._list_models() if call.name == "get_models" else self._read_asset(call)
            call.reply(encode(response, Format.MSGPACK), make_encoding(response, Format.MSGPACK))

    def _list_models(self) -> GetModelsResponse:
        models = list(dict.fromkeys(self.models.values()))
        entities = tuple(
            EntityModel(name, name, models.index(model)) for name, model in self.models.items()
        )
        return GetModelsResponse(
            roster=self.roster,
            entities=entities,
            models=tuple(models),
            environment=self.environment,
        )

    def _read_asset(self, call: object) -> GetAssetResponse:
        request = decode(GetAssetRequest, call.payload, call.encoding)  # type: ignore[attr-defined]
        data = self.assets[request.sha256]
        return GetAssetResponse(data=data[request.offset :][:100], total=len(data))


def scans_of(heard: MemorySubscription) -> list[tuple[str, LaserScan]]:
    """Take the scans heard: key and message."""
    return [(one.key, decode(LaserScan, one.payload, one.encoding)) for one in heard.take()]
