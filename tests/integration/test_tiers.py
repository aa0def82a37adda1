"""Dynamics requested by entities on a real server: reported, switched, and kept in the journal."""

from pathlib import Path

import pytest

from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import Server, eventually, free_endpoint, running_agents, serving
from tests.integration.robots import robot
from zensim.proto.messages.entity_messages import GetEntityInfoRequest
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.service_catalog import GET_ENTITY_INFO

STEPS_OF_COMMAND = 24
CRATE = """<robot name="crate"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def an_order(
    name: str, x: float, dynamics: Dynamics, resource: str = "box_bot"
) -> SpawnEntityOrder:
    return SpawnEntityOrder(
        name,
        entity_resource=Resource(resource),
        initial_pose=PoseStamped(pose=Pose(Point(x))),
        snap_to_ground=True,
        dynamics=dynamics,
    )


def tier_of(server: Server, name: str) -> str:
    return server.bus.call(GET_ENTITY_INFO, GetEntityInfoRequest(name), world="default").dynamics


def test_requested_dynamics_apply_and_are_restored_after_a_kill(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with serving_with_journal(tmp_path, endpoint) as server:
        for x, dynamics in enumerate(("", "kinematic", "auto")):
            server.client.spawn(an_order(f"r{x}", float(x), dynamics))  # type: ignore[arg-type]
        assert [tier_of(server, f"r{x}") for x in range(3)] == ["full", "kinematic", "kinematic"]
        kill_hard(server)

    with serving_with_journal(tmp_path, endpoint) as server:
        eventually(lambda: tier_of(server, "r2") == "kinematic", 10.0, "settling")
        assert [tier_of(server, f"r{x}") for x in range(2)] == ["full", "kinematic"]


def test_entity_without_drive_is_refused_in_one_line() -> None:
    order = SpawnEntityOrder(
        "crate", entity_resource=Resource(resource_string=CRATE), dynamics="kinematic"
    )
    with serving() as server:
        with pytest.raises(ServiceError, match="kinematic"):
            server.client.spawn(order)

        assert server.client.entities() == ()


def test_robot_switches_to_full_dynamics_before_contact_without_odometry_jump() -> None:
    # Paused, so that no time passes between the switch and the look at it.
    with serving("--dynamics", "auto", "--paused") as server:
        server.client.spawn(an_order("r0", 0.0, ""))
        server.client.spawn(an_order("r1", 0.6, ""))
        with running_agents(server, "r0"):
            driver = robot(server.bus, "r0")

            def has_met() -> bool:
                driver.command(0.3)
                server.client.step(STEPS_OF_COMMAND)
                return tier_of(server, "r1") == "full"

            assert tier_of(server, "r0") == "kinematic"
            eventually(has_met, 20.0, "meeting")
            assert tier_of(server, "r0") == "full"
            place = server.client.entity_state("r0").pose.position
            assert 0.3 < place.x < 0.5
