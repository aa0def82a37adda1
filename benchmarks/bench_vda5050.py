"""Vehicles of VDA 5050

Robots of a kinematic world stand 3 m apart, as vehicles at mosquitto. A scripted master sends each
a square of 1.5 m, and the next one when it is back. Order to motion is wall time until a state with
`driving`; CPU is that of `zensim vda5050`.
"""

import time
from collections.abc import Iterator

from benchmarks.figures import Figure, table
from benchmarks.machine import used_s
from benchmarks.secured_server import deployed_by, make_up_words
from tests.integration.scripted_master import running_vehicles
from zensim.proto.endpoints import with_free_port

__all__ = ["rows", "table"]


def rows(*, is_short: bool) -> Iterator[Figure]:
    count, seconds = (3, 3.0) if is_short else (1000, 60.0)
    endpoint = with_free_port("tcp/127.0.0.1:0")
    words = (*make_up_words(count, endpoint, is_secure=False), "--dynamics", "kinematic")
    with deployed_by(words, endpoint) as world, running_vehicles(endpoint) as (master, program):
        master.wait_for(count)
        begin = time.monotonic(), world.client.info().sim_time_s, used_s(program)
        master.begin()
        time.sleep(seconds)
        end = time.monotonic(), world.client.info().sim_time_s, used_s(program)
    wall_s, sim_s, cpu_s = (after - before for before, after in zip(begin, end, strict=True))
    moved_ms = tuple(1e3 * one for one in master.moved_s)
    yield Figure(what=f"{count} vehicles: real-time factor", unit="", samples=(sim_s / wall_s,))
    yield Figure(what=f"{count} vehicles: CPU", unit="cores", samples=(cpu_s / wall_s,))
    yield Figure(what=f"{count} vehicles: order to motion", unit="ms", samples=moved_ms)
