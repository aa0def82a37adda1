"""Efforts in joint_states over a real network, from single agents and from pools."""

import math
from pathlib import Path

import pytest

from tests.integration.processes import eventually, running, serving
from tests.integration.robots import robot
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import JointState
from zensim.sim_server.description.builtin_models import read_builtin_model

TORQUE_NM = 0.1
WORLD = """<sdf version="1.10"><world name="yard">
<include><uri>model://ground_plane</uri></include>
<model name="wall"><static>true</static><pose>0.5 0 0.1 0 0 0</pose><link name="link">
<collision name="brick"><geometry><box><size>0.2 2 0.2</size></box></geometry></collision>
</link></model></world></sdf>"""


def weak_box_bot() -> str:
    """A box_bot whose wheels cannot slip: its motors are weaker than their friction."""
    text = read_builtin_model("box_bot")
    start, end = (text.index(tag) for tag in ("<max_wheel_torque>", "</max_wheel_torque>"))
    return f"{text[:start]}<max_wheel_torque>{TORQUE_NM}{text[end:]}"


def wheel_efforts(bus: Bus, topic: str) -> tuple[float, ...]:
    """Drive towards the wall until both wheels push with the same torque twice."""
    listener, seen = bus.subscribe(topic, 1000), robot(bus, "r1")
    last: list[tuple[float, ...]] = [(math.nan,)]

    def is_steady() -> tuple[float, ...] | None:
        seen.command(0.3)
        for sample in listener.take():
            efforts = decode(JointState, sample.payload, sample.encoding).effort
            last.append(efforts)
        one, other = last[-2:] if len(last) > 1 else (last[0], last[0])
        is_same = one == pytest.approx(other, rel=0.02)
        return other if is_same and min(map(abs, other)) > 0.9 * TORQUE_NM else None

    return eventually(is_steady, 30.0, "a steady push")


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
@pytest.mark.parametrize("kind", ["alone", "pool"])
def test_wheels_that_push_against_a_wall_show_their_limit(
    tmp_path: Path, kind: str, engine: str
) -> None:
    model, world = tmp_path / "weak.urdf", tmp_path / "yard.sdf"
    model.write_text(weak_box_bot())
    world.write_text(WORLD)
    who = ("--pool", "0", "--name", "p") if kind == "pool" else ("r1",)
    with serving("--world", str(world), "--engine", engine) as server:
        spawned = server.zensim("spawn", str(model), "--name", "r1", "--json")
        assert spawned.returncode == 0, spawned.stderr
        with running("agent", *who, "--connect", server.endpoint):
            efforts = wheel_efforts(server.bus, "r1/joint_states")

    assert efforts == pytest.approx([TORQUE_NM] * 2, rel=0.02)
