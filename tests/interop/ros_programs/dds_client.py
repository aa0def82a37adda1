"""A client of services over DDS, with the request header of rmw_cyclonedds_cpp in the payload.

    dds_client.py spawn DESCRIPTION COUNT     spawns box_bot0 and so on, one metre apart
    dds_client.py lockstep ROBOT ...          lets time wait for cmd_vel after scan
    dds_client.py pause; dds_client.py play

It prints an object in JSON, and imports nothing of zensim.
"""

import json
import os
import sys
import time
from dataclasses import dataclass, field, fields
from pathlib import Path

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll)
GUID = 0x7A656E73696D
WITHIN_S = 30.0
STRING = 4
"""Type of a parameter."""


@dataclass
class EmptyRequest(IdlStruct, typename="std_srvs::srv::dds_::Empty_Request_"):
    guid: types.uint64 = 0
    sequence: types.int64 = 0
    dummy: types.uint8 = 0


@dataclass
class EmptyReply(IdlStruct, typename="std_srvs::srv::dds_::Empty_Response_"):
    guid: types.uint64 = 0
    sequence: types.int64 = 0
    dummy: types.uint8 = 0


@dataclass
class SpawnRequest(IdlStruct, typename="gazebo_msgs::srv::dds_::SpawnEntity_Request_"):
    guid: types.uint64 = 0
    sequence: types.int64 = 0
    name: str = ""
    xml: str = ""
    robot_namespace: str = ""
    x: types.float64 = 0.0
    y: types.float64 = 0.0
    z: types.float64 = 0.0
    qx: types.float64 = 0.0
    qy: types.float64 = 0.0
    qz: types.float64 = 0.0
    qw: types.float64 = 1.0
    reference_frame: str = ""


@dataclass
class SpawnReply(IdlStruct, typename="gazebo_msgs::srv::dds_::SpawnEntity_Response_"):
    guid: types.uint64 = 0
    sequence: types.int64 = 0
    success: bool = False
    status_message: str = ""


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: types.uint8 = 0
    bool_value: bool = False
    integer_value: types.int64 = 0
    double_value: types.float64 = 0.0
    string_value: str = ""
    byte_array_value: types.sequence[types.uint8] = field(default_factory=list)
    bool_array_value: types.sequence[bool] = field(default_factory=list)
    integer_array_value: types.sequence[types.int64] = field(default_factory=list)
    double_array_value: types.sequence[types.float64] = field(default_factory=list)
    string_array_value: types.sequence[str] = field(default_factory=list)


@dataclass
class NamedParameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str = ""
    value: ParameterValue = field(default_factory=ParameterValue)


@dataclass
class SetRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Request_"):
    guid: types.uint64 = 0
    sequence: types.int64 = 0
    parameters: types.sequence[NamedParameter] = field(default_factory=list)


@dataclass
class SetResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool = False
    reason: str = ""


@dataclass
class SetReply(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Response_"):
    guid: types.uint64 = 0
    sequence: types.int64 = 0
    results: types.sequence[SetResult] = field(default_factory=list)


class Client:
    """A client of one service."""

    def __init__(self, member: DomainParticipant, name: str, request: type, reply: type) -> None:
        self._sent = 0
        self._writer = DataWriter(
            member, Topic(member, f"rq{name}Request", request, qos=QOS), qos=QOS
        )
        self._reader = DataReader(member, Topic(member, f"rr{name}Reply", reply, qos=QOS), qos=QOS)
        wait_until(
            lambda: (
                self._writer.get_matched_subscriptions() and self._reader.get_matched_publications()
            )
        )

    def call(self, request: object) -> dict:
        """Send a request; return the fields of the reply, and the time that it took [ms]."""
        self._sent += 1
        request.guid, request.sequence = GUID, self._sent
        began_s = time.monotonic()
        self._writer.write(request)
        own = lambda: next((r for r in self._reader.take(8) if r.sequence == self._sent), None)  # noqa: E731
        found = wait_until(own)
        names = [one.name for one in fields(found) if one.name not in {"guid", "sequence"}]
        values = {name: getattr(found, name) for name in names}
        return values | {"ms": (time.monotonic() - began_s) * 1e3}


def wait_until(find: object) -> object:
    """Call a function until it finds something."""
    end_s = time.monotonic() + WITHIN_S
    while not (found := find()):
        if time.monotonic() > end_s:
            sys.exit("no reply or no server in time")
        time.sleep(0.002)
    return found


def spawn(member: DomainParticipant, description: str, count: str) -> dict:
    """Spawn robots in a row."""
    client = Client(member, "/gazebo/spawn_entity", SpawnRequest, SpawnReply)
    xml = Path(description).read_text(encoding="utf-8")
    names = [f"box_bot{number}" for number in range(int(count))]
    replies = [
        client.call(SpawnRequest(name=name, xml=xml, robot_namespace=name, x=float(place), z=0.01))
        for place, name in enumerate(names)
    ]
    return {
        "refused": [r["status_message"] for r in replies if not r["success"]],
        "ms": [r["ms"] for r in replies],
    }


def lockstep(member: DomainParticipant, *robots: str) -> dict:
    """Let time wait for the commands of robots after their scans."""
    client = Client(member, "/zensim/set_parameters", SetRequest, SetReply)
    parameters = [
        NamedParameter(
            f"lockstep./{one}/cmd_vel", ParameterValue(STRING, string_value=f"/{one}/scan")
        )
        for one in robots
    ]
    results = client.call(SetRequest(parameters=parameters))["results"]
    return {"refused": [one.reason for one in results if not one.successful]}


def call_empty(member: DomainParticipant, name: str) -> dict:
    """Call a service without fields."""
    return {"ms": Client(member, name, EmptyRequest, EmptyReply).call(EmptyRequest())["ms"]}


def main() -> None:
    """Call what the first argument names."""
    what, *given = sys.argv[1:]
    member = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    if what == "spawn":
        found = spawn(member, *given)
    elif what == "lockstep":
        found = lockstep(member, *given)
    else:
        found = call_empty(member, {"pause": "/pause_physics", "play": "/unpause_physics"}[what])
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
