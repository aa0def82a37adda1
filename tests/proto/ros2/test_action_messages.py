"""Messages of actions against an independent implementation of types, hashes and bytes."""

import msgspec
import pytest

from tests.proto.ros_hashes import hash_of_message, hash_of_service
from tests.proto.ros_oracle import ros_bytes
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.ros2 import action_messages as action
from zensim.proto.ros2.trajectory_messages import FOLLOW_JOINT_TRAJECTORY
from zensim.proto.ros2.type_hash import find_service_type, hash_service, hash_type
from zensim.proto.sample_messages import make_sample_message

SERVICES = action.ACTION_SERVICES | FOLLOW_JOINT_TRAJECTORY.list_services("r1/arm/follow")
TOPICS = action.ACTION_TOPICS | FOLLOW_JOINT_TRAJECTORY.list_topics("r1/arm/follow")
KINDS = list(
    dict.fromkeys([*TOPICS.values(), *(kind for halves in SERVICES.values() for kind in halves)])
)


def name_of(kind: type[msgspec.Struct]) -> str:
    return str(vars(kind)["ros_type"])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_type_of_the_action_has_the_hash_that_another_implementation_finds(
    kind: type[msgspec.Struct],
) -> None:
    assert hash_type(kind) == hash_of_message(name_of(kind))


@pytest.mark.parametrize("name", SERVICES)
def test_service_of_the_action_has_the_hash_that_another_implementation_finds(name: str) -> None:
    request, response = SERVICES[name]

    assert hash_service(request, response) == hash_of_service(find_service_type(request))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_message_of_the_action_has_the_bytes_that_ros_writes(kind: type[msgspec.Struct]) -> None:
    message = make_sample_message(kind)

    written = encode(message, Format.CDR)

    assert written == ros_bytes(message, name_of(kind))
    assert decode(kind, written) == message


def test_status_of_goals_has_the_bytes_that_ros_writes() -> None:
    info = action.GoalInfo(action.GoalId(tuple(range(16))))
    message = action.GoalStatusArray((action.GoalStatusMessage(info, 2),))

    assert encode(message, Format.CDR) == ros_bytes(message, "action_msgs/msg/GoalStatusArray")
