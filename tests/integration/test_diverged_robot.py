"""A robot that diverges is frozen in a real server; others keep driving."""

import math
import struct
from pathlib import Path

from tests.integration.processes import eventually, running_agents, serving
from tests.integration.robots import drive_for, robot
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Event, Snapshot
from zensim.proto.topic_catalog import EVENTS, SNAPSHOT

INERTIAL = """<inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/>
<inertia ixx="{moment}" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"/></inertial>"""
LINK = '<link name="{name}">' + INERTIAL + "</link>"
JOINT = """<joint name="j{n}" type="continuous"><parent link="l{above}"/><child link="l{n}"/>
<origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>{mimic}</joint>"""
MASSES = (("1e-4", "1e-8"), ("1e12", "1e12"), ("1e-4", "1e-8"))


def mismatched() -> str:
    """Adjacent masses differ by 1e16, with a gear ratio of 1e6."""
    links = "".join(
        LINK.format(name=f"l{n}", x=0.3 if n else 0.0, mass=mass, moment=moment)
        for n, (mass, moment) in enumerate(MASSES)
    )
    gear = '<mimic joint="j1" multiplier="1e6"/>'
    joints = "".join(
        JOINT.format(n=n, above=n - 1, mimic=gear if n > 1 else "") for n in range(1, len(MASSES))
    )
    return f'<robot name="mismatched">{links}{joints}</robot>'


def test_diverged_robot_is_frozen_while_others_drive(tmp_path: Path) -> None:
    file = tmp_path / "mismatched.urdf"
    file.write_text(mismatched(), encoding="utf-8")
    with serving() as server:
        assert server.zensim("spawn", "box_bot", "--name", "r1").returncode == 0
        with running_agents(server, "r1"):
            events = server.bus.subscribe(EVENTS.key("default"), 1000)
            shown = server.bus.subscribe(SNAPSHOT.key("default"), 100_000)
            other = robot(server.bus, "r1")
            where = ("-x", "0", "-y", "3", "-z", "1")
            assert server.zensim("spawn", str(file), "--name", "bad", *where).returncode == 0

            (drive_result,) = drive_for(server.client, [other], linear=0.2, angular=0.0, sim_s=4.0)

            received = [decode(Event, one.payload, one.encoding) for one in events.take()]
            warned = [event for event in received if event.kind == "warning"]
            assert [event.entity for event in warned if "frozen" in event.message] == ["bad"]
            assert math.isclose(drive_result.forward_m, 0.8, rel_tol=0.03)
            snapshots = eventually(shown.take, 10.0, "a snapshot")
            for sample in snapshots:
                base = decode(Snapshot, sample.payload, sample.encoding).base
                assert all(map(math.isfinite, struct.unpack(f"<{len(base) // 8}d", base)))
            assert set(server.client.entities()) == {"r1", "bad"}
            server.client.delete("bad")
