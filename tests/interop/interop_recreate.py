"""Clients in turn

A process creates a service client, calls, and destroys the client, 200 times: ten runs beside ten
robots that drive. In the last rows the callback of a reply holds the client, as in rmw_zenoh_cpp
0.2.10: the process waits for itself as soon as it destroys the client meanwhile
(https://github.com/ros2/rmw_zenoh/issues/993), whatever it calls. That figure has no limit.
"""

from collections.abc import Iterator

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of
from tests.interop.foreign_peers import Stage, list_routers, stage
from zensim.proto.ros2.node_messages import ListParametersRequest, ListParametersResponse
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.ros2.type_hash import find_service_type, hash_service

ROBOTS = 10
CALLS, RUNS, RUNS_WHEN_SHORT = 200, 10, 1
WITHIN_S = 120.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Count the calls that a process makes before one gets no reply."""
    runs = RUNS_WHEN_SHORT if is_short else RUNS
    for router in list_routers(is_short=is_short):
        with stage(router) as network:
            robots = network.spawn(ROBOTS)
            with network.agents("--pool", "0"):
                network.wait_until_driven(ROBOTS)
                plain = [call_in_turn(network, robots[0]) for _ in range(runs)]
                held = [call_in_turn(network, robots[0], "--held-by-callback") for _ in range(runs)]
        yield all_of(f"{router}: runs of {CALLS} calls with all replies", plain.count(CALLS), runs)
        samples = tuple(float(one) for one in held)
        what = f"{router}: replies until a client that its callback holds"
        yield Figure(what=what, unit="", samples=samples)


def call_in_turn(network: Stage, robot: str, *options: str) -> int:
    """Run a process that makes the calls; return how many got a reply."""
    request, response = ListParametersRequest, ListParametersResponse
    service, ros_type = f"{robot}/agent/list_parameters", find_service_type(request)
    key = make_data_key(0, service, ros_type, hash_service(request, response))
    calls = ("--key", key, "--calls", str(CALLS))
    return int(network.run("recreate", *calls, *options, within_s=WITHIN_S)["answered"])
