"""ROS nodes in lockstep: controllers that answer scans, slow ones and one that is killed."""

from tests.integration.node_runs import WAIT, lidar_fleet, run_nodes, running_controllers
from tests.integration.repeatable_run import state_hash
from tests.integration.sensor_runs import read_stats

ROBOTS, STEPS = 2, 240


def test_slow_nodes_give_the_same_state_and_time_goes_on_without_a_killed_one() -> None:
    fast = run_nodes(ROBOTS, STEPS)
    with (
        lidar_fleet(ROBOTS, WAIT) as (server, names),
        running_controllers(server, names, 0.03) as process,
    ):
        server.client.simulate_steps(STEPS)
        slow = state_hash(server.bus)
        process.kill()
        server.client.simulate_steps(STEPS)
        stats = read_stats(server)

    assert fast.state == slow
    assert fast.way_m > 0.1
    assert (stats.steps, stats.awaited, stats.misses) == (2 * STEPS, (), {})
