"""Robots of other drives receive twists over the network."""

from tests.integration.processes import running_agents, serving
from tests.integration.robots import Robot, place, robot, stamp_s, yaw
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Twist, Vector3

HEIGHT_M = "0.05"
STRAFE = Twist(Vector3(0.0, 0.3))
CURVE = Twist(Vector3(0.3), Vector3(z=0.4))


def test_robots_of_two_drives_receive_twists_over_the_network() -> None:
    with serving() as server:
        for name, y in (("omni_bot", "0"), ("car_bot", "3")):
            where = ("-x", "0", "-y", y, "-z", HEIGHT_M)
            assert server.zensim("spawn", name, "--name", name, *where).returncode == 0
        with running_agents(server, "omni_bot", "car_bot"):
            omni, car = robot(server.bus, "omni_bot"), robot(server.bus, "car_bot")

            _drive(omni, car)

            ahead, left = place(omni.now())
            assert left > 0.5
            assert abs(ahead) < 0.05
            assert abs(yaw(car.now())) > 0.3


def _drive(omni: Robot, car: Robot) -> None:
    begin_s = stamp_s(omni.now())
    while stamp_s(omni.now()) < begin_s + 3.0:
        omni.cmd_vel.send(encode(STRAFE, Format.CDR))
        car.cmd_vel.send(encode(CURVE, Format.CDR))
