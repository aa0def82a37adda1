"""The service catalog."""

import pytest

from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.service_catalog import GET_ENTITIES, SERVICES, SPAWN_ENTITY

GAZEBO = {
    "pause_physics": "Empty",
    "unpause_physics": "Empty",
    "reset_world": "Empty",
    "gazebo_reset_simulation": "Empty",
    "clear_link_wrenches": "LinkRequest",
    "clear_joint_efforts": "JointRequest",
    "gazebo_get_entity_state": "GetEntityState",
    "gazebo_set_entity_state": "SetEntityState",
}
"""Services with another type name in ROS."""


@pytest.mark.parametrize("name", SERVICES)
def test_service_is_found_by_its_own_name(name: str) -> None:
    assert SERVICES[name].name == name


@pytest.mark.parametrize("name", SERVICES)
def test_messages_of_a_service_are_named_as_ros_names_them(name: str) -> None:
    camel = GAZEBO.get(name) or "".join(word.capitalize() for word in name.split("_"))

    request, response = SERVICES[name].request, SERVICES[name].response

    assert getattr(request, "ros_type", "").endswith(f"/srv/{camel}_Request")
    assert getattr(response, "ros_type", "").endswith(f"/srv/{camel}_Response")


@pytest.mark.parametrize(
    ("code", "name"),
    [
        (ResultCode.OK, "OK"),
        (ResultCode.NOT_FOUND, "NOT_FOUND"),
        (SpawnCode.NAME_NOT_UNIQUE, "NAME_NOT_UNIQUE"),
        (77, "UNKNOWN_CODE"),
    ],
)
def test_service_names_its_codes(code: int, name: str) -> None:
    assert SPAWN_ENTITY.code_name(code) == name


def test_service_does_not_name_the_codes_of_another() -> None:
    assert GET_ENTITIES.code_name(SpawnCode.NAME_NOT_UNIQUE) == "UNKNOWN_CODE"
