"""Calls of programs for Gazebo Classic: the tutorial's script, and spawn_entity.py.

Each call has the fields of those programs, by an independent client and on the plain keys
of a bridge; types have no hashes, as in humble.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import pytest

from tests.integration import ros_interfaces as ros
from tests.integration.processes import Server, eventually, running_agents, serving
from tests.integration.ros_client_process import (
    CallObserver,
    CallService,
    make_service_call,
    replies,
    run_observer,
)
from tests.integration.ros_subscriptions import DISCOVERY_S
from tests.proto.ros_hashes import hash_of_service
from tests.proto.ros_oracle import HUMBLE
from zensim.sim_server.description.builtin_models import read_builtin_model

SPAWN, DELETE = "gazebo_msgs/srv/SpawnEntity", "gazebo_msgs/srv/DeleteEntity"
EMPTY = "std_srvs/srv/Empty"
HUMBLES = ("--ros-distro", "humble")
FORWARD = {"orientation": {"w": 1.0}}


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving("--ros-domain", "0", "--ros-bridge", *HUMBLES) as found:
        yield found


@pytest.fixture(scope="module")
def observe(server: Server) -> Iterator[CallObserver]:
    with run_observer(server, 0, ros.OF_HUMBLE) as found:
        yield found


def description_by_the_script(namespace: str) -> str:
    """Edit the robot like the tutorial's script: a namespace, and tf in it."""
    root = ET.fromstring(read_builtin_model("box_bot_legacy"))
    plugins = {plugin.get("name"): plugin for plugin in root.iter("plugin")}
    block = plugins["differential_drive_controller"].find("ros")
    assert block is not None
    ET.SubElement(block, "namespace").text = f"/{namespace}"
    ET.SubElement(block, "remapping").text = f"/tf:=/{namespace}/tf"
    return ET.tostring(root, encoding="unicode")


def spawned(
    call_service: CallService, name: str, type_hash: str = ros.OF_HUMBLE, **fields: object
) -> Any:  # noqa: ANN401
    return call_service("/spawn_entity", SPAWN, type_hash, name=name, **fields)


def test_service_is_available_to_a_waiting_script(observe: CallObserver) -> None:
    listed = observe("services")

    assert {SPAWN, DELETE} <= {*listed["/spawn_entity"], *listed["/delete_entity"]}
    assert listed["/unpause_physics"] == [EMPTY]


@pytest.mark.parametrize("orientation", [{}, {"w": 1.0}], ids=["all zero", "by default"])
def test_tutorial_script_spawns_robots_in_a_row(
    server: Server, observe: CallObserver, orientation: dict[str, float]
) -> None:
    names = [f"box_bot{number}" for number in range(3)]
    received = [
        spawned(
            make_service_call(observe),
            name,
            xml=description_by_the_script(name),
            robot_namespace=name,
            initial_pose={"position": {"x": x, "z": 0.01}, "orientation": orientation},
        )
        for x, name in enumerate(names)
    ]
    places = [server.client.entity_state(name).pose.position.x for name in names]
    deleted = [
        make_service_call(observe)("/delete_entity", DELETE, ros.OF_HUMBLE, name=name)
        for name in names
    ]

    assert [one["success"] for one in received] == [True] * 3, received
    assert places == pytest.approx([0.0, 1.0, 2.0], abs=0.05)
    assert [one and one["success"] for one in deleted] == [True] * 3


def test_robot_of_the_script_publishes_tf_and_odometry_in_its_namespace(
    server: Server, observe: CallObserver
) -> None:
    name = "box_bot7"
    xml = description_by_the_script(name)
    pose = {"position": {"y": 4.0, "z": 0.01}, "orientation": {"w": 1.0}}
    spawned(make_service_call(observe), name, xml=xml, robot_namespace=name, initial_pose=pose)
    given = {"count": 1, "within_s": DISCOVERY_S, "qos": ""}

    with running_agents(server, name, options=HUMBLES):
        (odom,) = observe("receive", topic=f"/{name}/odom", kind="nav_msgs/msg/Odometry", **given)
        (tf,) = observe("receive", topic=f"/{name}/tf", kind="tf2_msgs/msg/TFMessage", **given)
    make_service_call(observe)("/delete_entity", DELETE, ros.OF_HUMBLE, name=name)

    assert odom["header"]["frame_id"] == "odom"
    assert odom["pose"]["pose"]["position"]["y"] == pytest.approx(4.0, abs=0.05)
    assert tf["transforms"][0]["header"]["frame_id"] == "odom"


def test_spawn_entity_py_spawns_waits_unpauses_and_deletes(
    server: Server, observe: CallObserver
) -> None:
    call_service = make_service_call(observe)
    call_service("/pause_physics", EMPTY, ros.OF_HUMBLE)
    pose = {"position": {"x": -3.0, "z": 0.06}, "orientation": {"z": 1.0, "w": 0.0}}

    received = spawned(
        call_service,
        "e1",
        xml=read_builtin_model("box_bot"),
        initial_pose=pose,
        reference_frame="world",
    )
    call_service("/unpause_physics", EMPTY, ros.OF_HUMBLE)
    states = {"topic": "/model_states", "kind": "gazebo_msgs/msg/ModelStates", "qos": ""}
    (seen,) = observe("receive", count=1, within_s=DISCOVERY_S, **states)
    before = server.steps()
    eventually(lambda: server.steps() > before, DISCOVERY_S, "time going on")
    deleted = call_service("/delete_entity", DELETE, ros.OF_HUMBLE, name="e1")

    assert received["success"], received
    assert "e1" in seen["name"]
    assert seen["pose"][seen["name"].index("e1")]["position"]["x"] == pytest.approx(-3.0, abs=0.01)
    assert deleted is not None
    assert deleted["success"]


def test_models_are_listed_and_the_simulation_is_reset_as_gazebo_does(
    server: Server, observe: CallObserver
) -> None:
    call_service = make_service_call(observe)
    spawned(call_service, "kept", xml=read_builtin_model("box_bot"), initial_pose=FORWARD)
    epoch = server.client.info().epoch

    listed = call_service("/get_model_list", "gazebo_msgs/srv/GetModelList", ros.OF_HUMBLE)
    reset = call_service("/reset_simulation", EMPTY, ros.OF_HUMBLE)

    assert listed is not None
    assert (listed["success"], listed["model_names"]) == (True, ["kept"])
    assert reset is not None
    assert server.client.info().epoch > epoch
    assert server.client.entities() == ("kept",)
    call_service("/delete_entity", DELETE, ros.OF_HUMBLE, name="kept")


def test_duplicate_name_is_refused_with_a_message(observe: CallObserver) -> None:
    call_service = make_service_call(observe)
    spawned(call_service, "twin", xml=read_builtin_model("box_bot"), initial_pose=FORWARD)

    again = spawned(call_service, "twin", xml=read_builtin_model("box_bot"), initial_pose=FORWARD)
    call_service("/delete_entity", DELETE, ros.OF_HUMBLE, name="twin")

    assert not again["success"]
    assert "twin" in again["status_message"]


def test_distribution_with_hashes_calls_by_hash(observe: CallObserver) -> None:
    received = spawned(
        make_service_call(observe),
        "hashed",
        hash_of_service(SPAWN),
        xml=read_builtin_model("box_bot"),
        **{"initial_pose": FORWARD},
    )
    deleted = make_service_call(observe)(
        "/delete_entity", DELETE, hash_of_service(DELETE), name="hashed"
    )

    assert received["success"]
    assert deleted is not None
    assert deleted["success"]


def test_bridge_spawns_and_deletes_on_plain_keys(server: Server) -> None:
    types = HUMBLE.types
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](8.0, 0.0, 0.06),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    request = types["gazebo_msgs/msg/SpawnEntity_Request"](
        "bridged", read_builtin_model("box_bot"), "bridged", pose, ""
    )

    received = [
        answer_to(server, "gazebo/spawn_entity", request, "SpawnEntity"),
        answer_to(
            server,
            "gazebo/delete_entity",
            types["gazebo_msgs/msg/DeleteEntity_Request"]("bridged"),
            "DeleteEntity",
        ),
    ]

    assert [one.success for one in received] == [True, True], received


def answer_to(server: Server, key: str, request: object, kind: str) -> Any:  # noqa: ANN401
    payload = bytes(HUMBLE.serialize_cdr(request, f"gazebo_msgs/msg/{kind}_Request"))
    (response,) = replies(server, key, payload, None)
    return HUMBLE.deserialize_cdr(response.payload.to_bytes(), f"gazebo_msgs/msg/{kind}_Response")
