"""`zensim replay` beside a running world: what a subscriber gets, requests, keys, refusals."""

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import zensim as api
from tests.integration.processes import eventually, read_json_line, running
from tests.integration.processes import zensim as run_zensim
from tests.integration.terminals import on_terminal
from tests.recording.replays import make_odometry, make_text, write_run
from zensim.proto import keys, replay_catalog
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus, BusSubscription, open_bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.replay_messages import ReplayReport, ReplayRequest, ReplaySeekRequest
from zensim.proto.messages.standard_messages import Time
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.service_catalog import Request, Service

WITHIN_S = 30.0
DEPTH = 65536
WORLD = "asked"
FAST = ("--rate", "20", "--json")


@pytest.fixture(scope="module")
def sim() -> Iterator[api.Sim]:
    with api.launch(engine="mujoco", timeout_s=120.0) as sim:
        sim.spawn("box_bot", name="r1")
        yield sim


@pytest.fixture
def bus(sim: api.Sim) -> Iterator[Bus]:
    with open_bus(BusConfig(connect=(sim.endpoint,))) as bus:
        yield bus


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    write_run(path)
    return path


def call(bus: Bus, service: Service[Request, ReplayReport], request: Request) -> ReplayReport:
    """Call a service of a replay, also while it starts, or its link is closed by a busy host."""

    def attempt() -> ReplayReport | None:
        with suppress(NoServer, TimeoutError):
            return bus.call(service, request, world=WORLD)
        return None

    return eventually(attempt, WITHIN_S, service.name)


def take_many(subscription: BusSubscription, least: int) -> list[bytes]:
    """Take payloads until there are so many: the last may arrive after their publisher's end."""
    found: list[bytes] = []

    def has_enough() -> bool:
        found.extend(one.payload for one in subscription.take())
        return len(found) >= least

    eventually(has_enough, WITHIN_S, f"{least} messages")
    return found


def extend_times(times: list[Time], clock: BusSubscription) -> list[Time]:
    times += [decode(WorldClock, one.payload).clock for one in clock.take()]
    return times


def read_state(bus: Bus) -> ReplayReport:
    return call(bus, replay_catalog.GET_STATE, ReplayRequest())


def test_subscribers_get_all_messages_on_both_keys_and_a_clock(
    sim: api.Sim, bus: Bus, recorded: Path
) -> None:
    plain = bus.subscribe("first/r1/odom", DEPTH)
    ros = bus.subscribe("0/first/r1/odom/*/*", DEPTH)
    clock = bus.subscribe("sim/first/clock", DEPTH)
    description = bus.subscribe("first/r1/robot_description", DEPTH)

    with running(
        "replay", str(recorded), "--connect", sim.endpoint, "--namespace", "first", *FAST
    ) as process:
        facts, figures = read_json_line(process), read_json_line(process)
        assert process.wait(WITHIN_S) == ExitCode.OK

    wanted = [make_odometry(number) for number in range(101)]
    assert take_many(plain, 101) == wanted
    assert take_many(ros, 101) == wanted
    assert set(take_many(description, 2)) == {make_text("<robot/>"), make_text("<robot2/>")}
    times: list[Time] = []
    eventually(lambda: extend_times(times, clock)[-1:] == [Time(15)], WITHIN_S, "the last time")
    assert times == sorted(times, key=lambda one: (one.sec, one.nanosec))
    assert times[0].sec == 5
    assert (facts["world"], facts["topics"]) == ("first", 5)
    assert figures["messages"] == 101 + 3 + 3


def test_file_that_was_never_closed_is_replayed_with_one_warning(
    sim: api.Sim, tmp_path: Path, recorded: Path
) -> None:
    path = tmp_path / "cut.mcap"
    content = recorded.read_bytes()
    path.write_bytes(content[: content.index(b"\x04\x00\x00\x00zstd", len(content) // 2) - 30])

    found = run_zensim(
        "replay", str(path), "--connect", sim.endpoint, "--namespace", "cut", "--rate", "0"
    )

    assert found.returncode == ExitCode.OK
    assert found.stderr.count("never closed") == 1
    assert len([line for line in found.stderr.splitlines() if "note:" in line]) == 1


def test_replay_onto_a_living_robot_is_refused_and_named(sim: api.Sim, recorded: Path) -> None:
    at = ("--connect", sim.endpoint, "--rate", "0")

    refused = run_zensim("replay", str(recorded), *at)
    of_robot = run_zensim("replay", str(recorded), *at, "--world-name", "other", "--topics", "r1/*")
    forced = run_zensim(
        *("replay", str(recorded), *at, "--world-name", "other", "--force", "--clock", "0"),
        *("--topics", "/r1/custom"),
    )

    assert (refused.returncode, of_robot.returncode) == (ExitCode.USAGE, ExitCode.USAGE)
    assert "'r1'" in of_robot.stderr
    assert forced.returncode == ExitCode.OK


def test_requests_and_the_token_are_of_the_replayed_world(
    sim: api.Sim, bus: Bus, recorded: Path
) -> None:
    options = ("--connect", sim.endpoint, "--namespace", WORLD, "--start-paused", "--json")
    with running("replay", str(recorded), *options) as process:
        read_json_line(process)
        eventually(lambda: bus.list_tokens(keys.alive_replay(WORLD)), WITHIN_S, "a token")
        paused = read_state(bus)
        moved = call(bus, replay_catalog.SEEK, ReplaySeekRequest(8.0))
        late = bus.get(f"{WORLD}/r1/robot_description")
        second = run_zensim(
            "replay", str(recorded), "--connect", sim.endpoint, "--namespace", WORLD
        )
        call(bus, replay_catalog.RESUME, ReplayRequest())
        figures = read_json_line(process)

    assert (paused.is_paused, paused.position_s, paused.duration_s) == (True, 0.0, 10.0)
    assert (moved.position_s, moved.time_ns) == (8.0, 13_000_000_000)
    assert [one.payload for one in late] == [make_text("<robot2/>")]
    assert second.returncode == ExitCode.USAGE
    assert figures["position_s"] == 10.0


def test_keys_of_a_terminal_pause_step_and_set_the_rate(
    sim: api.Sim, bus: Bus, recorded: Path
) -> None:
    arguments = ("replay", str(recorded), "--namespace", WORLD, "--rate", "0.1")
    with on_terminal(sim, *arguments) as terminal:
        terminal.wait_for("playing")
        terminal.type(" ")
        terminal.wait_for("paused")
        before = read_state(bus)
        terminal.type("\x1b[C\x1b[C\x1b[A")
        eventually(lambda: read_state(bus).published == before.published + 2, WITHIN_S, "a step")
        after = read_state(bus)
        terminal.type("\x03")
        status = terminal.status()

    assert after.rate == pytest.approx(0.11)
    assert (before.is_paused, after.is_paused) == (True, True)
    assert status == ExitCode.OK


def test_recording_of_a_world_is_replayed_as_it_was(sim: api.Sim, bus: Bus, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sim.play()
    recording = ("--all", "-o", str(path), "--duration", "2", "--connect", sim.endpoint, "--json")
    run_zensim("record", *recording)
    sim.pause()
    info = json.loads(run_zensim("bag", "info", str(path), "--json").stdout)
    odometry = bus.subscribe("again/r1/odom", DEPTH)
    snapshots = bus.subscribe("sim/again/snapshot", DEPTH)

    run_zensim(
        *("replay", str(path), "--namespace", "again", "--rate", "0", "--connect", sim.endpoint)
    )

    counts = {one["name"]: one["messages"] for one in info["topics"]}
    for subscription, name in ((odometry, "/r1/odom"), (snapshots, "/sim/default/snapshot")):
        assert len(take_many(subscription, counts[name])) == counts[name] > 0
