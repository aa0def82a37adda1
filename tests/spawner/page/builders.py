"""Models, snapshots and a server for tests of the viewer."""

from collections.abc import Mapping

import msgspec
import numpy as np

from tests.fakes import MemoryBus
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Sensor, Shape
from zensim.proto.messages.sensor_messages import SensorTopic
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse, Snapshot
from zensim.proto.service_catalog import SERVICES
from zensim.proto.topic_catalog import SNAPSHOT

BLUE = (0.1, 0.3, 0.9, 1.0)
CUBE = Shape("box", (0.1, 0.1, 0.1), rgba=BLUE)
WHEEL = Shape("cylinder", (0.035, 0.01, 0.0))


def make_robot(name: str = "bot", *, shape: Shape = CUBE) -> Model:
    """Make a cube with one wheel; all names start with `name`."""
    return Model(
        name,
        (Link(f"{name}_base", visuals=(shape,)), Link(f"{name}_wheel", visuals=(WHEEL,))),
        (
            Joint(
                f"{name}_axle",
                "continuous",
                f"{name}_base",
                f"{name}_wheel",
                Origin((0.0, 0.05, 0.0)),
                (0.0, 1.0, 0.0),
            ),
        ),
        drive=DiffDrive(),
    )


def make_sensing_robot() -> Model:
    """Make a robot with a lidar 0.2 m above its wheel, and a camera on its base."""
    above = Origin((0.0, 0.0, 0.2))
    lidar = Sensor(
        "laser", "ray", "bot_wheel", "bot_wheel", above, topics=(SensorTopic("scan", "scan"),)
    )
    topics = SensorTopic("image_raw", "camera/image_raw"), SensorTopic("camera_info", "camera/info")
    camera = Sensor("camera", "camera", "bot_base", "bot_base", topics=topics)
    return msgspec.structs.replace(make_robot(), sensors=(lidar, camera))


def make_wall(name: str = "wall") -> Model:
    """Make a static model without a drive."""
    return Model(name, (Link("base", visuals=(Shape("box", (1.0, 0.1, 1.0)),)),), is_static=True)


def make_models(roster: int = 1, **entities: Model) -> GetModelsResponse:
    """Make the response of `get_models`; namespaces equal names."""
    return make_models_by_name(entities, roster)


def make_models_by_name(entities: Mapping[str, Model], roster: int = 1) -> GetModelsResponse:
    """Make the response of `get_models` for entities by name."""
    models = tuple(dict.fromkeys(entities.values()))
    members = tuple(EntityModel(n, n, models.index(model)) for n, model in entities.items())
    return GetModelsResponse(roster=roster, entities=members, models=models)


def make_snapshot(
    *names: str, roster: int = 1, joints: int = 0, state: str = "playing", at_x: float = 0.0
) -> Snapshot:
    """Make a snapshot of entities in a row along x, 1 m apart."""
    base = np.zeros((len(names), 13))
    base[:, 0] = np.arange(len(names)) + at_x
    base[:, 6] = 1.0
    return Snapshot(
        epoch=0,
        step=240,
        time_ns=1_000_000_000,
        roster=roster,
        names=names,
        base=base.tobytes(),
        joint_positions=np.zeros(joints).tobytes(),
        real_time_factor=0.98,
        state=state,  # type: ignore[arg-type]
    )


class FakeServer:
    """Replies, publishes and records requests on a bus in memory."""

    def __init__(self, bus: MemoryBus, models: GetModelsResponse) -> None:
        self.models = models
        self.responses: dict[str, msgspec.Struct] = {}
        """Responses by service; the default is success."""
        self.is_silent = False
        self.requests: list[msgspec.Struct] = []
        self._bus = bus
        self._calls = bus.serve(keys.services("default"))
        bus.pumps.append(self._reply)

    def publish(self, snapshot: Snapshot) -> None:
        self._bus.put_message(SNAPSHOT.key("default"), snapshot, Format.MSGPACK)

    def count(self, request: type[msgspec.Struct]) -> int:
        return sum(isinstance(one, request) for one in self.requests)

    def _reply(self) -> None:
        for call in [] if self.is_silent else self._calls.take():
            service = SERVICES[call.name]
            self.requests.append(decode(service.request, call.payload, call.encoding))
            response = self.responses.get(call.name, service.response())
            if call.name == "get_models":
                response = self.responses.get(call.name, self.models)
            call.reply(encode(response, Format.MSGPACK), Format.MSGPACK.value)
