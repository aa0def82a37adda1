"""Small models and snapshots for the viewer's tests."""

from collections.abc import Mapping

import msgspec
import numpy as np

from tests.fakes import MemoryBus
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.model_messages import DiffDrive, Joint, Link, Model, Origin, Shape
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse, Snapshot
from zensim.proto.service_catalog import SERVICES
from zensim.proto.topic_catalog import SNAPSHOT

BLUE = (0.1, 0.3, 0.9, 1.0)
CUBE = Shape("box", (0.1, 0.1, 0.1), rgba=BLUE)
WHEEL = Shape("cylinder", (0.035, 0.01, 0.0))


def a_robot(name: str = "bot", *, shape: Shape = CUBE) -> Model:
    """A cube with one wheel, and a name in all that it has."""
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


def a_wall(name: str = "wall") -> Model:
    """Something that nobody drives."""
    return Model(name, (Link("base", visuals=(Shape("box", (1.0, 0.1, 1.0)),)),), is_static=True)


def models_of(roster: int = 1, **entities: Model) -> GetModelsResponse:
    """Answer `get_models` for these entities; each is in the namespace of its own name."""
    return models_in(entities, roster)


def models_in(entities: Mapping[str, Model], roster: int = 1) -> GetModelsResponse:
    """Answer `get_models` for these entities by name."""
    models = tuple(dict.fromkeys(entities.values()))
    members = tuple(EntityModel(n, n, models.index(model)) for n, model in entities.items())
    return GetModelsResponse(roster=roster, entities=members, models=models)


def a_snapshot(
    *names: str, roster: int = 1, joints: int = 0, state: str = "playing", at_x: float = 0.0
) -> Snapshot:
    """Entities in a row along x, a metre apart."""
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


class World:
    """A server on a network in memory: it answers and publishes, and notes what it is asked."""

    def __init__(self, bus: MemoryBus, models: GetModelsResponse) -> None:
        self.models = models
        self.answers: dict[str, msgspec.Struct] = {}
        """Other answers than yes, by service."""
        self.is_deaf = False
        self.asked: list[msgspec.Struct] = []
        self._bus = bus
        self._calls = bus.serve(keys.services("default"))
        bus.pumps.append(self._answer)

    def publish(self, snapshot: Snapshot) -> None:
        self._bus.put_message(SNAPSHOT.key("default"), snapshot, Format.MSGPACK)

    def count(self, request: type[msgspec.Struct]) -> int:
        return sum(isinstance(asked, request) for asked in self.asked)

    def _answer(self) -> None:
        for call in [] if self.is_deaf else self._calls.take():
            service = SERVICES[call.name]
            self.asked.append(decode(service.request, call.payload, call.encoding))
            answer = self.answers.get(call.name, service.response())
            if call.name == "get_models":
                answer = self.answers.get(call.name, self.models)
            call.reply(encode(answer, Format.MSGPACK), Format.MSGPACK.value)
