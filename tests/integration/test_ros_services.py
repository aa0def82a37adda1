"""ROS 2 services, called by an independent client and by the bytes of rmw_zenoh."""

import json
import time
from collections.abc import Iterator

import pytest

from tests.integration import ros_interfaces as ros
from tests.integration.processes import Server, serving
from tests.integration.ros_client_process import CallService, replies, result_of, ros_client
from tests.proto.ros_oracle import rewritten_by_ros
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, DeleteEntityResponse
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.proto.ros2.ros_service_catalog import CDR_ENCODING_NAME

SPAWN = "simulation_interfaces/srv/SpawnEntity"
DELETE = "simulation_interfaces/srv/DeleteEntity"
GET_ENTITIES = "simulation_interfaces/srv/GetEntities"
DELETE_KEY = f"0/delete_entity/simulation_interfaces::srv::dds_::DeleteEntity_/{ros.DELETE_HASH}"
AT_ORIGIN = {"pose": {"orientation": {"w": 1.0}}}
BOX = (
    '<robot name="box"><link name="base"><inertial><mass value="1"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>'
)
GID = bytes(range(16))


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving("--ros-domain", "0", "--ros-bridge") as found:
        yield found


@pytest.fixture(scope="module")
def call_service(server: Server) -> Iterator[CallService]:
    with ros_client(server) as found:
        yield found


def listed(call_service: CallService) -> list[object]:
    response = call_service("/get_entities", GET_ENTITIES, ros.GET_ENTITIES_HASH)
    assert result_of(response) == ResultCode.OK
    assert response is not None
    entities = response["entities"]
    assert isinstance(entities, list)
    return entities


@pytest.mark.parametrize(
    ("kind", "type_hash", "resource"),
    [
        (SPAWN, ros.SPAWN_V2_HASH, {"entity_resource": {"uri": "box_bot"}}),
        pytest.param(
            *(ros.SPAWN_V1, ros.SPAWN_V1_HASH, {"uri": "box_bot"}), marks=pytest.mark.long_form
        ),
        (ros.SPAWN_V1, ros.OF_HUMBLE, {"uri": "box_bot"}),
    ],
    ids=["2.1", "1.x", "humble"],
)
def test_ros_client_spawns_lists_and_deletes_in_each_version(
    server: Server, kind: str, type_hash: str, resource: dict[str, object]
) -> None:
    with ros_client(server) as call_service:
        spawned = call_service(
            "/spawn_entity", kind, type_hash, name="v", initial_pose=AT_ORIGIN, **resource
        )
        there = listed(call_service)
        deleted = call_service("/delete_entity", DELETE, ros.DELETE_HASH, entity="v")

        assert result_of(spawned) == ResultCode.OK
        assert there == ["v"]
        assert result_of(deleted) == ResultCode.OK
        assert listed(call_service) == []


def test_ros_client_receives_a_code_when_refused(call_service: CallService) -> None:
    response = call_service("/delete_entity", DELETE, ros.DELETE_HASH, entity="nobody")

    assert result_of(response) == ResultCode.NOT_FOUND


def test_script_of_gazebo_spawns_and_deletes_under_the_same_names(
    call_service: CallService,
) -> None:
    spawned = call_service(
        "/spawn_entity",
        "gazebo_msgs/srv/SpawnEntity",
        ros.OF_HUMBLE,
        name="g",
        xml=BOX,
        robot_namespace="demo",
        initial_pose={"position": {"x": 5.0, "z": 1.0}, "orientation": {"w": 1.0}},
        reference_frame="world",
    )
    there = listed(call_service)
    deleted = call_service(
        "/delete_entity", "gazebo_msgs/srv/DeleteEntity", ros.OF_HUMBLE, name="g"
    )
    again = call_service("/delete_entity", "gazebo_msgs/srv/DeleteEntity", ros.OF_HUMBLE, name="g")

    assert spawned is not None
    assert spawned["success"], spawned["status_message"]
    assert there == ["g"]
    assert deleted is not None
    assert deleted["success"]
    assert again is not None
    assert not again["success"]
    assert "g" in str(again["status_message"])


def test_state_of_version_1_is_set_and_read_back(call_service: CallService) -> None:
    call_service(
        "/spawn_entity",
        SPAWN,
        ros.SPAWN_V2_HASH,
        name="s",
        entity_resource={"uri": "box_bot"},
        initial_pose=AT_ORIGIN,
    )
    state = {"pose": {"position": {"x": 9.0, "z": 0.03}, "orientation": {"w": 1.0}}}

    done = call_service(
        "/set_entity_state",
        "simulation_interfaces/srv/SetEntityState",
        ros.SET_STATE_V1_HASH,
        entity="s",
        state=state,
    )
    read = call_service(
        "/get_entity_state",
        "simulation_interfaces/srv/GetEntityState",
        ros.GET_STATE_HASH,
        entity="s",
    )
    call_service("/delete_entity", DELETE, ros.DELETE_HASH, entity="s")

    assert result_of(done) == ResultCode.OK
    assert read is not None
    found = json.loads(json.dumps(read))["state"]["pose"]["position"]["x"]
    assert found == pytest.approx(9.0, abs=0.01)


def test_reply_has_sequence_number_and_gid_of_the_request_and_its_own_time(server: Server) -> None:
    request = write_attachment(Attachment(41, 7, GID))
    payload = encode(DeleteEntityRequest("nobody"), Format.CDR)
    before_ns = time.time_ns()

    (reply,) = replies(server, DELETE_KEY, payload, request)

    assert reply.attachment is not None
    received = read_attachment(reply.attachment.to_bytes())
    assert received is not None
    assert (received.sequence_number, received.gid) == (41, GID)
    assert before_ns <= received.source_time_ns <= time.time_ns()
    assert str(reply.key_expr) == DELETE_KEY
    written = reply.payload.to_bytes()
    assert rewritten_by_ros(written, "simulation_interfaces/srv/DeleteEntity_Response") == written


def test_malformed_request_gets_a_response_with_a_code(server: Server) -> None:
    request = write_attachment(Attachment(1, 0, GID))

    (reply,) = replies(server, DELETE_KEY, b"\x00\x01\x00\x00\xff\xff\xff\x7f", request)

    response = decode(DeleteEntityResponse, reply.payload.to_bytes(), CDR_ENCODING_NAME)
    assert response.result.result == ResultCode.OPERATION_FAILED
    assert "malformed" in response.result.error_message


def test_service_with_another_hash_does_not_reply(server: Server) -> None:
    other = DELETE_KEY[:-4] + "0000"

    found = replies(
        server,
        other,
        encode(DeleteEntityRequest("x"), Format.CDR),
        write_attachment(Attachment(1, 0, GID)),
    )

    assert found == []


def test_other_domain_receives_no_messages(server: Server) -> None:
    found = replies(
        server,
        DELETE_KEY.replace("0/", "7/", 1),
        encode(DeleteEntityRequest("x"), Format.CDR),
        write_attachment(Attachment(1, 0, GID)),
    )

    assert found == []


def test_bridge_calls_on_plain_keys_in_either_version(
    server: Server, call_service: CallService
) -> None:
    call_service(
        "/spawn_entity",
        SPAWN,
        ros.SPAWN_V2_HASH,
        name="b",
        entity_resource={"uri": "box_bot"},
        initial_pose=AT_ORIGIN,
    )
    payload = encode(DeleteEntityRequest("b"), Format.CDR)

    (deleted,) = replies(server, "delete_entity", payload, None)
    (of_gazebo,) = replies(server, "gazebo/delete_entity", payload, None)

    response = decode(DeleteEntityResponse, deleted.payload.to_bytes(), CDR_ENCODING_NAME)
    assert response.result.result == ResultCode.OK
    assert of_gazebo.payload.to_bytes()[4] == 0, "success is the first byte"


def test_server_without_a_domain_has_no_ros_services() -> None:
    with serving("--ros-domain", "off") as server:
        found = replies(
            server,
            DELETE_KEY,
            encode(DeleteEntityRequest("x"), Format.CDR),
            write_attachment(Attachment(1, 0, GID)),
        )

        assert found == []
        assert server.client.info().world == "default"
