"""Requests and responses of earlier interfaces are converted."""

import pytest

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
from zensim.proto.ros2 import earlier_service_types
from zensim.proto.ros2.ros_service_catalog import CDR_ENCODING_NAME, ROS_SERVICES, RosService
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.service_catalog import SERVICES

POSE = Pose(position=Point(1.0, 2.0, 3.0))


def form(service: str, request: str) -> RosService:
    (found,) = (
        one
        for one in ROS_SERVICES
        if one.service == service and one.request.__name__.endswith(request)
    )
    return found


def test_version_1_of_a_spawn_names_its_resource_by_two_fields() -> None:
    request = earlier_service_types.SpawnEntityRequestV1(
        "r1", uri="u", resource_string="text", entity_namespace="ns"
    )

    read = form("spawn_entity", "V1").decode_request(encode(request, Format.CDR))

    assert read == SpawnEntityRequest(
        "r1", entity_resource=Resource("u", "text"), entity_namespace="ns"
    )


def test_version_1_of_a_state_sets_pose_and_twist() -> None:
    request = earlier_service_types.SetEntityStateRequestV1("r1", EntityState(pose=POSE))

    read = form("set_entity_state", "V1").decode_request(encode(request, Format.CDR))

    assert read == SetEntityStateRequest(
        "r1", EntityState(pose=POSE), set_pose=True, set_twist=True
    )


def test_gazebo_spawn_request_is_converted() -> None:
    request = earlier_service_types.GazeboSpawnEntityRequest("r1", "<robot/>", "ns", POSE, "world")

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
    request = encode(earlier_service_types.GazeboDeleteEntityRequest("r1"), Format.CDR)

    assert form("delete_entity", "GazeboDeleteEntityRequest").decode_request(
        request
    ) == DeleteEntityRequest("r1")


@pytest.mark.parametrize("written", [Format.CDR, Format.MSGPACK])
def test_gazebo_response_has_the_error_message(written: Format) -> None:
    no = DeleteEntityResponse(Result(ResultCode.NOT_FOUND, "there is no r1"))

    response = form("delete_entity", "GazeboDeleteEntityRequest").encode_response(
        encode(no, written), make_encoding(no, written)
    )

    assert decode(
        earlier_service_types.GazeboDeleteEntityResponse, response, CDR_ENCODING_NAME
    ) == (
        earlier_service_types.GazeboDeleteEntityResponse(
            success=False, status_message="there is no r1"
        )
    )


def test_gazebo_response_names_the_spawned_entity() -> None:
    yes = SpawnEntityReport(Result(), "r1_0")

    response = form("spawn_entity", "GazeboSpawnEntityRequest").encode_response(
        encode(yes, Format.MSGPACK), make_encoding(yes, Format.MSGPACK)
    )

    decoded = decode(earlier_service_types.GazeboSpawnEntityResponse, response, CDR_ENCODING_NAME)
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
        one for one in ROS_SERVICES if one.response is earlier_service_types.GetSpawnablesResponseV1
    )
    response = found.encode_response(
        encode(current, Format.MSGPACK), make_encoding(current, Format.MSGPACK)
    )

    decoded = decode(earlier_service_types.GetSpawnablesResponseV1, response, CDR_ENCODING_NAME)
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
