"""Gazebo services over the network, on a robot in PyBullet."""

import pytest

from tests.integration.processes import Server, eventually, serving
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.gazebo_messages import (
    LinkStates,
    ModelStates,
    ODEJointProperties,
    SetLinkPropertiesRequest,
)
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import Point, Pose, Vector3, Wrench
from zensim.proto.topic_catalog import LINK_STATES, MODEL_STATES
from zensim.spawner.client.gazebo_client import GazeboClient

PUSH_N = 2.0


def spawned(server: Server, *names: str) -> GazeboClient:
    for i, name in enumerate(names):
        done = server.zensim("spawn", "box_bot", "--name", name, "-x", str(2 * i))
        assert done.returncode == 0, done.stderr
    return GazeboClient(server.bus)


def test_robot_is_pushed_for_the_requested_duration() -> None:
    with serving() as server:
        gazebo = spawned(server, "r1", "r2")
        gazebo.pause_physics()
        assert server.client.simulation_state() == State.PAUSED
        wrench = Wrench(Vector3(0.0, 0.0, 20.0 * gazebo.link_properties("r1::base_link").mass))
        before = gazebo.entity_state("r1").pose.position.z

        message = gazebo.apply_link_wrench("r1::base_link", wrench, duration_s=0.25)
        assert message.startswith("from ")
        server.client.step(60)
        risen = gazebo.entity_state("r1")
        server.client.step(240)

        assert risen.pose.position.z > before + 0.05
        assert risen.twist.linear.z > 0.3
        assert gazebo.entity_state("r1").pose.position.z == pytest.approx(before, abs=0.02)
        assert gazebo.entity_state("r2").pose.position.z == pytest.approx(before, abs=0.01)
        gazebo.unpause_physics()
        assert server.client.simulation_state() == State.PLAYING


def test_wheel_is_turned_until_it_is_cleared_and_the_world_is_reset() -> None:
    with serving("--paused") as server:
        gazebo = spawned(server, "r1")
        for side in ("left", "right"):
            gazebo.set_joint_properties(f"r1::{side}_wheel_joint", ODEJointProperties(fmax=(0.0,)))

        gazebo.apply_joint_effort("r1::left_wheel_joint", 5.0, duration_s=0.1)
        server.client.step(12)
        turning = gazebo.joint_properties("r1::left_wheel_joint")
        steps = server.steps()
        gazebo.clear_joint_efforts("left_wheel_joint")
        gazebo.reset_world()

        assert turning.rate[0] != 0.0
        assert gazebo.joint_properties("r1::left_wheel_joint").rate == (0.0,)
        assert server.steps() == steps
        assert gazebo.model_list().model_names == server.client.entities() == ("r1",)
        gazebo.reset_simulation()
        assert server.steps() == 0
        assert server.client.entities() == ("r1",)


def test_states_are_published_and_returned() -> None:
    with serving() as server:
        gazebo = spawned(server, "r1", "r2")
        models = server.bus.subscribe(MODEL_STATES.key("default"), 4)
        links = server.bus.subscribe(LINK_STATES.key("default"), 4)

        model_sample = eventually(models.newest, 5.0, "hearing models")
        link_sample = eventually(links.newest, 5.0, "hearing links")

        received = decode(ModelStates, model_sample.payload, model_sample.encoding)
        assert received.name == ("r1", "r2")
        assert received.pose[1].position.x == pytest.approx(2.0, abs=0.05)
        parts = decode(LinkStates, link_sample.payload, link_sample.encoding)
        assert "r2::base_link" in parts.name
        assert len(parts.name) == len(parts.pose) == len(parts.twist)
        seen = gazebo.entity_state("r2", "r1")
        assert seen.pose.position.x == pytest.approx(2.0, abs=0.05)
        assert seen.reference_frame == "r1"


def test_link_mass_is_returned_and_refusals_are_precise() -> None:
    with serving() as server:
        gazebo = spawned(server, "r1")
        found = gazebo.link_properties("r1::base_link")
        gazebo.set_link_properties(
            SetLinkPropertiesRequest(
                "r1::base_link",
                Pose(Point(0.0, 0.0, 0.1)),
                gravity_mode=True,
                mass=2.0 * found.mass,
                ixx=1.0,
                iyy=1.0,
                izz=1.0,
            )
        )

        assert gazebo.link_properties("r1::base_link").mass == pytest.approx(2.0 * found.mass)
        for link, code in (("r9::base_link", ResultCode.NOT_FOUND), ("r1", ResultCode.NOT_FOUND)):
            with pytest.raises(ServiceError) as refused:
                gazebo.apply_link_wrench(link, Wrench(Vector3(PUSH_N)))
            assert refused.value.code == code
