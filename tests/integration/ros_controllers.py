"""`python -m tests.integration.ros_controllers ENDPOINT DELAY_S NAME ...`: ROS nodes in lockstep.

Each robot has a controller that answers a scan with a velocity command, on the keys of rmw_zenoh,
with their attachments and tokens. It asks the server to wait for it by a parameter. The program
prints `ready` when all have asked, and ends with its standard input.
"""

import json
import sys
import time
from collections.abc import Callable
from itertools import count

import zenoh

from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.standard_messages import LaserScan, Twist, Vector3
from zensim.proto.ros2 import node_messages as messages
from zensim.proto.ros2.rmw_attachment import Attachment, write_attachment
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.ros2.type_hash import find_service_type, hash_service, hash_type

CALL_S = 60.0
TWIST = "geometry_msgs/msg/Twist"
Request = messages.SetParametersRequest


def steer(scan: LaserScan) -> Twist:
    """Drive on, and turn to the side that has more room."""
    half = len(scan.ranges) // 2
    right, left = (
        sum(min(one, 8.0) for one in side) for side in (scan.ranges[:half], scan.ranges[half:])
    )
    turn = max(-1.0, min(1.0, (left - right) / 200.0))
    return Twist(linear=Vector3(x=0.3), angular=Vector3(z=turn))


def set_lockstep(session: zenoh.Session, topic: str, after: str) -> str:
    """Set the parameter by which time waits for a topic; return why it is refused."""
    kinds = Request, messages.SetParametersResponse
    key = make_data_key(
        0, "zensim/set_parameters", find_service_type(Request), hash_service(*kinds)
    )
    value = messages.ParameterValue(type=int(messages.ParameterType.STRING), string_value=after)
    request = Request((messages.NamedParameter(f"lockstep.{topic}", value),))
    found = session.get(
        key,
        payload=encode(request, Format.CDR),
        attachment=write_attachment(Attachment(1, time.time_ns(), bytes(16))),
        target=zenoh.QueryTarget.ALL_COMPLETE,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=CALL_S,
    )
    reply = next(one.ok for one in found if one.ok is not None)
    response = decode(messages.SetParametersResponse, reply.payload.to_bytes())
    return response.results[0].reason


def make_controller(
    session: zenoh.Session, name: str, delay_s: float
) -> Callable[[zenoh.Sample], None]:
    """Make the callback of a robot's scans."""
    key = make_data_key(0, f"{name}/cmd_vel", TWIST, hash_type(Twist))
    publisher, numbers = session.declare_publisher(key), count(1)

    def answer(sample: zenoh.Sample) -> None:
        time.sleep(delay_s)  # as a node that plans
        twist = steer(decode(LaserScan, sample.payload.to_bytes()))
        attachment = write_attachment(Attachment(next(numbers), time.time_ns(), bytes(16)))
        publisher.put(encode(twist, Format.CDR), attachment=attachment)

    return answer


def declare_publisher_token(
    session: zenoh.Session, number: int, name: str
) -> zenoh.LivelinessToken:
    """Announce the publisher of velocity commands to the graph."""
    place = f"@ros2_lv/0/{session.zid()}/{number}/{number}/MP/%/%/controller"
    kind = "geometry_msgs::msg::dds_::Twist_"
    token = f"{place}/%{name}%cmd_vel/{kind}/{hash_type(Twist)}/::,10:,:,:,,"
    return session.liveliness().declare_token(token)


def main() -> None:
    """Run the controllers."""
    endpoint, delay_s, *names = sys.argv[1:]
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("timestamping/enabled", "true")
    with zenoh.open(config) as session:
        kept: list[object] = []
        for number, name in enumerate(names):
            scans = make_data_key(
                0, f"{name}/scan", "sensor_msgs/msg/LaserScan", hash_type(LaserScan)
            )
            kept += [
                declare_publisher_token(session, number, name),
                session.declare_subscriber(scans, make_controller(session, name, float(delay_s))),
            ]
        refused = [set_lockstep(session, f"/{name}/cmd_vel", f"/{name}/scan") for name in names]
        assert not any(refused), refused
        sys.stdout.write('{"ready": true}\n')
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main()
