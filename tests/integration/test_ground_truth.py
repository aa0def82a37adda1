"""The agent publishes the ground truth of a p3d plug-in over a real network."""

from pathlib import Path

import pytest

from tests.integration.processes import eventually, running_agents, serving
from tests.integration.robots import drive_for, place, robot, stamp_s
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import Odometry
from zensim.sim_server.description.builtin_models import read_builtin_model

P3D = """<gazebo><plugin name="truth" filename="libgazebo_ros_p3d.so">
<ros><remapping>odom:=ground_truth/state</remapping></ros>
<body_name>base_link</body_name><frame_name>map</frame_name><update_rate>20</update_rate>
<gaussian_noise>0.01</gaussian_noise></plugin></gazebo></robot>"""


def test_ground_truth_follows_the_robot(tmp_path: Path) -> None:
    file = tmp_path / "seen.urdf"
    file.write_text(read_builtin_model("box_bot").replace("</robot>", P3D), encoding="utf-8")
    with serving() as server:
        spawned = server.zensim("spawn", str(file), "--name", "r1", "-x", "3", "--json")
        assert spawned.returncode == 0
        assert all(frame in spawned.stdout for frame in ("'base_link'", "'map'"))
        with running_agents(server, "r1"):
            truth = server.bus.subscribe("r1/ground_truth/state", 100_000)
            seen = robot(server.bus, "r1")

            drive_for(server.client, [seen], linear=0.2, angular=0.0, sim_s=3.0)

            received = eventually(truth.take, 20.0, "ground truth")
            first, last = (
                decode(Odometry, one.payload, one.encoding) for one in (received[0], received[-1])
            )
            odom = seen.now()
            assert (last.header.frame_id, last.child_frame_id) == ("map", "base_link")
            assert place(last)[0] - place(first)[0] == pytest.approx(0.6, abs=0.1)
            assert place(last) == pytest.approx(place(odom), abs=0.05)
            rate = (len(received) - 1) / (stamp_s(last) - stamp_s(first))
            assert rate == pytest.approx(20.0, rel=0.1)
            assert last.twist.covariance[0] == pytest.approx(1e-4)
