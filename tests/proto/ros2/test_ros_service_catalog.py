"""Names, types and versions of ROS 2 services."""

import msgspec
import pytest
import zenoh

from zensim.proto.codec.message_codec import Format, MalformedPayload, encode
from zensim.proto.messages.entity_messages import EntityState, SetEntityStateRequest
from zensim.proto.messages.standard_messages import Point, Pose
from zensim.proto.ros2 import earlier_service_types
from zensim.proto.ros2.ros_service_catalog import (
    ROS_SERVICES,
    find_served_keys,
    index_by_bridge_key,
    index_by_key,
)
from zensim.proto.sample_messages import make_sample_message

V1_HASHES = {
    "spawn_entity": "d4c086345d4194a5fc4c9ae45095736ca4062b5cdac4d06a42dec93d683e03cf",
    "load_world": "f210682338f195f6f06191b46b20ec4992bddf485d33e2cffab2dd15341b4e3e",
    "set_entity_state": "ca210e7d2b66629ae133c8e1edf5246e618106d75c78ed0556c0e7a33c59ee5e",
    "get_spawnables": "3bc0266bf8236058ff589c44512e013afe4f295427c39d44cff363d1c956bf36",
}
"""Published for simulation_interfaces 1.x."""
POSE = Pose(position=Point(1.0, 2.0, 3.0))


@pytest.mark.parametrize("service", V1_HASHES)
def test_version_1_of_a_service_has_the_published_hash(service: str) -> None:
    hashes = {one.type_hash for one in ROS_SERVICES if one.service == service}

    assert f"RIHS01_{V1_HASHES[service]}" in hashes


def test_a_name_has_a_key_for_each_package_and_each_version() -> None:
    types = [key.split("/")[2:] for key in index_by_key(0) if key.startswith("0/spawn_entity/")]

    of_gazebo = [hash_ for kind, hash_ in types if kind == "gazebo_msgs::srv::dds_::SpawnEntity_"]
    standard = [hash_ for kind, hash_ in types if kind.startswith("simulation_interfaces::")]
    assert len(of_gazebo) == len({"with its hash", "humble"})
    assert len(standard) == len({"2.1", "1.x", "humble"})


def test_humble_calls_version_1_on_keys_without_a_hash() -> None:
    key = "0/spawn_entity/simulation_interfaces::srv::dds_::SpawnEntity_/TypeHashNotSupported"

    found = index_by_key(0)[key]

    assert found[-1].request is earlier_service_types.SpawnEntityRequestV1


@pytest.mark.parametrize(
    ("service", "name"), [("spawn_entity", "SpawnEntity"), ("load_world", "LoadWorld")]
)
def test_requests_of_both_versions_have_equal_bytes(service: str, name: str) -> None:
    """So that humble, whose keys have no hash, can have either version."""
    key = f"0/{service}/simulation_interfaces::srv::dds_::{name}_/TypeHashNotSupported"
    newest, oldest = index_by_key(0)[key]
    request = encode(make_sample_message(oldest.request), Format.CDR)

    read = newest.decode_request(request)
    expected = msgspec.structs.asdict(oldest.decode_request(request))
    assert {name: getattr(read, name) for name in expected} == expected


def test_versions_of_a_state_differ_by_their_bytes() -> None:
    key = "0/set_entity_state/simulation_interfaces::srv::dds_::SetEntityState_/"
    newest, oldest = index_by_key(0)[f"{key}TypeHashNotSupported"]
    states = SetEntityStateRequest("r1", EntityState(pose=POSE), set_pose=True)
    older = earlier_service_types.SetEntityStateRequestV1("r1", EntityState(pose=POSE))

    assert newest.decode_request(encode(states, Format.CDR)) == states
    with pytest.raises(MalformedPayload):
        newest.decode_request(encode(older, Format.CDR))
    assert oldest.request is earlier_service_types.SetEntityStateRequestV1


def test_hash_keys_of_every_version_are_served_in_each_distribution() -> None:
    served = index_by_key(0)

    for one in ROS_SERVICES:
        assert served[one.list_keys(0)[0]] == (one,)


def test_served_key_expressions_match_every_key() -> None:
    patterns = [zenoh.KeyExpr(pattern) for pattern in find_served_keys(7)]

    assert [key for key in index_by_key(7) if not any(one.includes(key) for one in patterns)] == []
    assert len(patterns) < 10


def test_bridge_keys_of_gazebo_services_begin_with_gazebo() -> None:
    keys = index_by_bridge_key()

    assert {one.ros_type for one in keys["spawn_entity"]} == {
        "simulation_interfaces/srv/SpawnEntity"
    }
    assert keys["gazebo/spawn_entity"][0].ros_type == "gazebo_msgs/srv/SpawnEntity"
