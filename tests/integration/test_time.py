"""Time control with real agents: steps, goals, run-to-time, speed, and reset."""

import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.integration.processes import Server, agent_of, eventually, running_agents, serving
from tests.integration.robots import Robot, place, robot, stamp_s
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.simulation_messages import ResetScope, State, StepsProgress
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.topic_catalog import CLOCK

PERIOD = 3
"""Steps between two drive states, at 240 Hz."""
STEP_S = 1.0 / 240.0
SOON_S = 20.0


@pytest.fixture(scope="module")
def scene() -> Iterator[tuple[Server, Robot]]:
    """A paused server and a robot with its agent."""
    with serving("--paused") as server:
        assert server.zensim("spawn", "box_bot", "-n", "r1").returncode == 0
        with running_agents(server, "r1"):
            yield server, robot(server.bus, "r1")


@pytest.fixture(autouse=True)
def paused(scene: tuple[Server, Robot]) -> Iterator[None]:
    """Pause the world; restore its speed afterwards."""
    yield
    server, _ = scene
    if server.client.simulation_state() != State.PAUSED:
        server.client.set_simulation_state(State.PAUSED)


def last_stamp_s(found: Robot) -> float:
    """Get the stamp of the newest received odometry."""
    received = found.read()
    return stamp_s(received[-1]) if received else -1.0


def test_robot_in_a_paused_world_has_odometry(scene: tuple[Server, Robot]) -> None:
    server, _ = scene

    assert eventually(lambda: server.bus.get("r1/odom") or None, SOON_S, "odometry")


def test_outputs_of_the_last_step_are_published_before_the_reply(
    scene: tuple[Server, Robot],
) -> None:
    server, found = scene
    server.client.step(PERIOD - server.steps() % PERIOD)

    for steps in (PERIOD, 10 * PERIOD, PERIOD, 2 * PERIOD):
        server.client.step(steps)
        assert last_stamp_s(found) == pytest.approx(server.steps() * STEP_S, abs=1e-6)


def test_robot_moves_as_commanded_when_time_is_on_demand(scene: tuple[Server, Robot]) -> None:
    server, found = scene
    server.client.step(240)
    start = found.read()[-1]

    for _ in range(20):
        found.command(0.2)
        server.client.step(24)

    (x0, y0), (x1, y1) = place(start), place(found.read()[-1])
    assert ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5 == pytest.approx(0.4, abs=0.02)


def test_goal_reports_progress_and_succeeds(scene: tuple[Server, Robot]) -> None:
    server, _ = scene
    seen: list[StepsProgress] = []

    response = server.client.simulate_steps(960, on_progress=seen.append)

    assert (response.status, response.completed_steps) == ("succeeded", 960)
    assert seen[-1].status == "succeeded"
    assert [one.completed_steps for one in seen] == sorted(one.completed_steps for one in seen)


def test_goal_is_canceled_by_another_client(scene: tuple[Server, Robot]) -> None:
    server, _ = scene
    with ThreadPoolExecutor(1) as other:
        goal = other.submit(server.client.simulate_steps, 1_000_000, goal_id="long")
        eventually(lambda: "long" in _canceled(server), SOON_S, "canceling")

        with pytest.raises(ServiceError, match=r"\d+ of 1000000"):
            goal.result(SOON_S)


def _canceled(server: Server) -> tuple[str, ...]:
    return server.client.cancel_steps()


def test_goal_is_canceled_when_its_caller_cancels(scene: tuple[Server, Robot]) -> None:
    server, _ = scene

    def give_up(_: StepsProgress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        server.client.simulate_steps(1_000_000, on_progress=give_up)

    steps = server.steps()
    server.client.step(1)
    assert server.steps() == steps + 1


def test_goal_continues_when_its_caller_times_out_and_accepts_a_retry(
    scene: tuple[Server, Robot],
) -> None:
    server, _ = scene
    before = server.steps()
    with pytest.raises(TimeoutError):
        server.client.simulate_steps(1200, goal_id="joined", timeout_s=0.05)

    response = server.client.simulate_steps(1200, goal_id="joined")

    assert response.completed_steps == 1200
    assert server.steps() == before + 1200


def test_time_runs_to_the_requested_time(scene: tuple[Server, Robot]) -> None:
    server, _ = scene
    now_ns = round(server.client.info().sim_time_s * NANOSECONDS)

    reached = server.client.run_to(now_ns + NANOSECONDS)

    assert reached.completed_steps in (240, 241)
    assert 0 <= ns_from_time(reached.time) - now_ns - NANOSECONDS < NANOSECONDS // 240
    with pytest.raises(ServiceError) as refused:
        server.client.run_to(now_ns)
    assert refused.value.code == ResultCode.OPERATION_FAILED


@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_time_runs_at_the_speed_that_is_set(scene: tuple[Server, Robot], factor: float) -> None:
    server, _ = scene
    server.client.set_speed(factor)
    server.client.set_simulation_state(State.PLAYING)
    begin_s = time.monotonic()
    before_s = server.client.info().sim_time_s

    eventually(lambda: time.monotonic() > begin_s + 1.0, 5.0, "a second")

    passed_s = server.client.info().sim_time_s - before_s
    assert server.client.info().target_real_time_factor == factor
    # The upper bound is exact; a busy machine may be slower.
    assert 0.0 < passed_s <= factor * (time.monotonic() - begin_s) + 0.1
    server.client.set_speed(1.0)


@pytest.mark.parametrize("scope", [0, 1, 2, 3, 4, 5, 6, 7, 255])
def test_odometry_continues_in_a_new_epoch_after_a_reset(
    scene: tuple[Server, Robot], scope: int
) -> None:
    server, found = scene
    server.client.set_simulation_state(State.PLAYING)
    if not agent_of(server, "r1"):
        _spawn_again(server)
    found.command(0.3)
    found.now()
    agent, epoch = agent_of(server, "r1"), server.client.info().epoch

    server.client.reset(scope)
    reset_s = server.client.info().sim_time_s

    if scope == 0 or scope & ResetScope.SPAWNED:
        assert server.client.entities() == ()
        _spawn_again(server)
    else:
        assert agent_of(server, "r1") == agent
    assert server.client.info().epoch == epoch + 1
    # Odometry that was sent before the reset may arrive after the reply.
    eventually(lambda: _continues(server, found), SOON_S, "odometry of the new epoch")
    if scope == 0 or scope & ResetScope.TIME:
        assert reset_s < 1.0


def _continues(server: Server, found: Robot) -> bool:
    stamps = [stamp_s(found.now()) for _ in range(3)]
    return stamps == sorted(stamps) and abs(stamps[-1] - server.client.info().sim_time_s) < 1.0


def _spawn_again(server: Server) -> None:
    assert server.zensim("spawn", "box_bot", "-n", "r1").returncode == 0
    eventually(lambda: agent_of(server, "r1"), SOON_S, "claiming")


def test_suspended_server_does_not_catch_up_and_its_clock_is_monotonic(
    scene: tuple[Server, Robot],
) -> None:
    server, _ = scene
    clock = server.bus.subscribe(CLOCK.key("default"), 100_000)
    server.client.set_simulation_state(State.PLAYING)
    eventually(clock.newest, SOON_S, "the clock")
    began_s, before = time.monotonic(), server.steps()
    server.process.send_signal(signal.SIGSTOP)
    stopped_s = time.monotonic()
    eventually(lambda: time.monotonic() > stopped_s + 1.5, 5.0, "a while")

    woken_s = time.monotonic()
    server.process.send_signal(signal.SIGCONT)
    steps = server.steps()
    allowed = (stopped_s - began_s + time.monotonic() - woken_s + 0.3) / STEP_S

    assert steps - before < allowed
    received = [decode(WorldClock, sample.payload, sample.encoding) for sample in clock.take()]
    assert [(one.epoch, one.step) for one in received] == sorted(
        (one.epoch, one.step) for one in received
    )
