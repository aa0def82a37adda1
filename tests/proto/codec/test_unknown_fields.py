"""JSON with fields that a message does not have is refused."""

import json

import msgspec
import pytest

from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.messages.gazebo_messages import SetJointPropertiesRequest
from zensim.proto.messages.simulation_messages import ResetSimulationRequest
from zensim.proto.messages.spawn_messages import (
    Resource,
    SpawnEntitiesRequest,
    SpawnEntity,
    SpawnEntityRequest,
)
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.description.builtin_models import read_builtin_model

MISTAKES: tuple[tuple[type[msgspec.Struct], dict[str, object], str], ...] = (
    (ResetSimulationRequest, {"scop": 1}, "`scop`; use scope"),
    (SpawnEntityRequest, {"name": "k", "initial_pos": {}}, "`initial_pos`; use initial_pose"),
    (SpawnEntityRequest, {"initial_pose": {"pose": {"positon": {}}}}, "`positon`; use position"),
    (SetJointPropertiesRequest, {"ode_joint_config": {"hiStop": [0.5]}}, "`hiStop`"),
    (SpawnEntitiesRequest, {"spawn_requests": [{"name": "a"}, {"nme": "b"}]}, "`nme`; use name"),
    (Twist, {"linera": {"x": 1.0}}, "`linera`; use linear"),
)


@pytest.mark.parametrize(("kind", "given", "words"), MISTAKES)
def test_unknown_field_is_named_with_the_one_that_is_meant(
    kind: type[msgspec.Struct], given: dict[str, object], words: str
) -> None:
    with pytest.raises(MalformedPayload, match="unknown field") as refused:
        decode(kind, json.dumps(given).encode())

    assert words in str(refused.value)


def test_programs_of_another_version_may_have_more_fields() -> None:
    payload = msgspec.msgpack.encode({"scope": 1, "later": 2})

    assert decode(ResetSimulationRequest, payload) == ResetSimulationRequest(1)


@pytest.mark.parametrize("service", SERVICES.values(), ids=lambda one: str(one.name))
def test_every_message_of_services_is_read_as_it_is_written(service: object) -> None:
    for kind in (service.request, service.response):  # type: ignore[attr-defined]
        message = kind()

        assert decode(kind, encode(message, Format.JSON)) == message


def test_nested_messages_are_read_as_they_are_written() -> None:
    entity = SpawnEntity(
        "r1", entity_resource=Resource(resource_string=read_builtin_model("box_bot"))
    )
    request = SpawnEntitiesRequest((entity,))

    assert decode(SpawnEntitiesRequest, encode(request, Format.JSON)) == request
