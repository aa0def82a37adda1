"""Names, types and versions of ROS 2 services."""

import msgspec
import pytest
import zenoh

from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode, make_encoding
from zensim.proto.messages.entity_messages import EntityState, SetEntityStateRequest
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import GetSimulatorFeaturesResponse
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    DeleteEntityResponse,
    GetSpawnablesResponse,
    Resource,
    Spawnable,
    SpawnEntityReport,
    SpawnEntityRequest,
    SpawnEntityResponse,
)
from zensim.proto.messages.standard_messages import Header, Point, Pose, PoseStamped
from zensim.proto.ros2 import ros_service_catalog
from zensim.proto.ros2.ros_service_catalog import (
    CDR_ENCODING_NAME,
    ROS_SERVICES,
    RosService,
    find_served_keys,
    index_by_bridge_key,
    index_by_key,
)
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.service_catalog import SERVICES

V1_HASHES = {
    "spawn_entity": "d4c086345d4194a5fc4c9ae45095736ca4062b5cdac4d06a42dec93d683e03cf",
    "load_world": "f210682338f195f6f06191b46b20ec4992bddf485d33e2cffab2dd15341b4e3e",
    "set_entity_state": "ca210e7d2b66629ae133c8e1edf5246e618106d75c78ed0556c0e7a33c59ee5e",
    "get_spawnables": "3bc0266bf8236058ff589c44512e013afe4f295427c39d44cff363d1c956bf36",
}
"""Published for simulation_interfaces 1.x."""
POSE = Pose(position=Point(1.0, 2.0, 3.0))


def form(service: str, request: str) -> RosService:
    (found,) = (
        one
        for one in ROS_SERVICES
        if one.service == service and one.request.__name__.endswith(request)
    )
    return found


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

    assert found[-1].request is ros_service_catalog.SpawnEntityRequestV1


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
    older = ros_service_catalog.SetEntityStateRequestV1("r1", EntityState(pose=POSE))

    assert newest.decode_request(encode(states, Format.CDR)) == states
    with pytest.raises(MalformedPayload):
        newest.decode_request(encode(older, Format.CDR))
    assert oldest.request is ros_service_catalog.SetEntityStateRequestV1


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


def test_version_1_of_a_spawn_names_its_resource_by_two_fields() -> None:
    request = ros_service_catalog.SpawnEntityRequestV1(
        "r1", uri="u", resource_string="text", entity_namespace="ns"
    )

    read = form("spawn_entity", "V1").decode_request(encode(request, Format.CDR))

    assert read == SpawnEntityRequest(
        "r1", entity_resource=Resource("u", "text"), entity_namespace="ns"
    )


def test_version_1_of_a_state_sets_pose_and_twist() -> None:
    request = ros_service_catalog.SetEntityStateRequestV1("r1", EntityState(pose=POSE))

    read = form("set_entity_state", "V1").decode_request(encode(request, Format.CDR))

    assert read == SetEntityStateRequest(
        "r1", EntityState(pose=POSE), set_pose=True, set_twist=True
    )


def test_gazebo_spawn_request_is_converted() -> None:
    request = ros_service_catalog.GazeboSpawnEntityRequest("r1", "<robot/>", "ns", POSE, "world")

    read = form("spawn_entity", "GazeboSpawnEntityRequest").decode_request(
        encode(request, Format.CDR)
    )

    assert read == SpawnEntityRequest(
        "r1",
        entity_resource=Resource(resource_string="<robot/>"),
        entity_namespace="ns",
        initial_pose=PoseStamped(Header(frame_id="world"), POSE),
    )


def test_gazebo_delete_request_is_converted() -> None:
    request = encode(ros_service_catalog.GazeboDeleteEntityRequest("r1"), Format.CDR)

    assert form("delete_entity", "GazeboDeleteEntityRequest").decode_request(
        request
    ) == DeleteEntityRequest("r1")


@pytest.mark.parametrize("written", [Format.CDR, Format.MSGPACK])
def test_gazebo_response_has_the_error_message(written: Format) -> None:
    no = DeleteEntityResponse(Result(ResultCode.NOT_FOUND, "there is no r1"))

    response = form("delete_entity", "GazeboDeleteEntityRequest").encode_response(
        encode(no, written), make_encoding(no, written)
    )

    assert decode(ros_service_catalog.GazeboDeleteEntityResponse, response, CDR_ENCODING_NAME) == (
        ros_service_catalog.GazeboDeleteEntityResponse(
            success=False, status_message="there is no r1"
        )
    )


def test_gazebo_response_names_the_spawned_entity() -> None:
    yes = SpawnEntityReport(Result(), "r1_0")

    response = form("spawn_entity", "GazeboSpawnEntityRequest").encode_response(
        encode(yes, Format.MSGPACK), make_encoding(yes, Format.MSGPACK)
    )

    decoded = decode(ros_service_catalog.GazeboSpawnEntityResponse, response, CDR_ENCODING_NAME)
    assert decoded.success
    assert "r1_0" in decoded.status_message


def test_cdr_of_the_current_version_is_returned_unchanged() -> None:
    yes = encode(SpawnEntityReport(Result(), "r1"), Format.CDR)

    response = form("spawn_entity", "SpawnEntityOrder").encode_response(
        yes, make_encoding(SpawnEntityReport, Format.CDR)
    )

    assert decode(SpawnEntityResponse, response, CDR_ENCODING_NAME).entity_name == "r1"


def test_spawnables_of_version_1_are_uris() -> None:
    current = GetSpawnablesResponse(Result(), (Spawnable(Resource("zensim://box_bot"), "a bot"),))

    (found,) = (
        one for one in ROS_SERVICES if one.response is ros_service_catalog.GetSpawnablesResponseV1
    )
    response = found.encode_response(
        encode(current, Format.MSGPACK), make_encoding(current, Format.MSGPACK)
    )

    decoded = decode(ros_service_catalog.GetSpawnablesResponseV1, response, CDR_ENCODING_NAME)
    assert [one.uri for one in decoded.spawnables] == ["zensim://box_bot"]


def test_refusal_yields_an_empty_response_if_that_has_no_result() -> None:
    no = DeleteEntityResponse(Result(ResultCode.OPERATION_FAILED, "malformed"))

    response = form("get_simulator_features", "Request").encode_response(
        encode(no, Format.MSGPACK), make_encoding(no, Format.MSGPACK)
    )

    assert (
        decode(GetSimulatorFeaturesResponse, response, CDR_ENCODING_NAME)
        == GetSimulatorFeaturesResponse()
    )


@pytest.mark.parametrize("one", ROS_SERVICES, ids=lambda one: f"{one.service} {one.ros_type}")
def test_requests_of_all_versions_have_all_fields(one: RosService) -> None:
    current = SERVICES[one.service].request

    read = one.decode_request(encode(make_sample_message(one.request), Format.CDR))

    assert set(read.__struct_fields__) <= set(current.__struct_fields__)
    assert issubclass(current, type(read))


@pytest.mark.parametrize("one", ROS_SERVICES, ids=lambda one: f"{one.service} {one.ros_type}")
def test_responses_of_all_versions_are_encoded(one: RosService) -> None:
    current = make_sample_message(SERVICES[one.service].response)

    response = one.encode_response(
        encode(current, Format.MSGPACK), make_encoding(current, Format.MSGPACK)
    )

    assert type(decode(one.response, response, CDR_ENCODING_NAME)) is one.response


def test_bytes_of_another_request_are_malformed() -> None:
    with pytest.raises(MalformedPayload):
        form("spawn_entity", "V1").decode_request(b"\x00\x01\x00\x00\xff\xff\xff\xff")
