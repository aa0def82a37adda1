"""Metrics of a server: what the loop counts, in few series."""

from pathlib import Path

import msgspec
import pytest

from tests.models import a_cart
from tests.sim_server.fakes import ServerFixture, a_server, a_spawn
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.sim_server.runtime.request_counts import NAMES
from zensim.sim_server.runtime.server_metrics import ServerMetrics, sum_file_sizes

MAX_SERIES = 300
"""Of a server, as docs/metrics.md says."""
SERIES_OF_JOURNAL_AND_PROCESS = 25


class Refused(msgspec.Struct, frozen=True):
    result: Result


def read(server: ServerFixture) -> dict[tuple[str, ...], float]:
    metrics = ServerMetrics(server.parts, "pybullet", server.loop.request_counts)
    return {
        (family.name + one.suffix, *one.labels.values()): one.value
        for family in metrics.list_metrics()
        for one in family.samples
    }


def test_metrics_are_those_of_the_loop() -> None:
    server = a_server("r1", "r2", cost_ns=3_000_000)
    server.request("info", InfoRequest())

    server.turn_for(2.0)

    found, clock = read(server), server.world.clock
    assert found["zensim_steps_total",] == clock.steps
    assert found["zensim_simulation_time_seconds",] == pytest.approx(clock.time_ns * 1e-9)
    assert found["zensim_real_time_factor",] == pytest.approx(1.0, abs=0.05)
    assert found["zensim_real_time_factor_target",] == 1.0
    assert found["zensim_step_duration_seconds_bucket", "0.002"] == 0
    assert found["zensim_step_duration_seconds_bucket", "0.005"] == clock.steps
    assert found["zensim_entities", "robot"] + found["zensim_entities", "object"] == 2
    assert found["zensim_requests_total", "info", "OK"] == 1
    assert found["zensim_request_duration_seconds_count", "info"] == 1


def test_paused_world_has_no_target() -> None:
    server = a_server("r1")
    server.world.clock.pause()

    server.turn_for(2.0)

    found = read(server)
    assert found["zensim_real_time_factor",] == found["zensim_real_time_factor_target",] == 0.0


def test_steps_that_begin_late_are_counted() -> None:
    on_time, late = a_server("r1"), a_server("r1", cost_ns=50_000_000)

    on_time.turn_for(1.0)
    late.turn_for(1.0)

    assert read(on_time)["zensim_late_steps_total",] == 0
    assert read(late)["zensim_late_steps_total",] >= 10
    assert read(late)["zensim_slipped_seconds_total",] > 0.1


def test_malformed_commands_are_counted_by_reason() -> None:
    server = a_server("r1")
    server.drive("nobody", 1.0)

    server.turn_for(0.1)

    assert read(server)["zensim_commands_rejected_total", "claims"] == 1
    assert read(server)["zensim_commands_received_total",] == 1


def test_commands_are_counted_against_those_due() -> None:
    server = a_server("r1", "r2")
    server.world.claim("a", ("r1", "r2"), "stop")
    server.drive("a", *[1.0] * 4)

    server.turn_for(0.1)
    driven = read(server)["zensim_driven_robots",]
    server.turn_for(1.4)

    found = read(server)
    assert (driven, found["zensim_driven_robots",]) == (2, 0)
    assert found["zensim_commands_taken_total",] == 1
    assert found["zensim_commands_due_total",] == pytest.approx(120, abs=3)
    assert found["zensim_commands_least_share",] == pytest.approx(1 / 80, abs=0.01)


def test_claimed_objects_do_not_count_as_robots_with_an_agent() -> None:
    server = a_server("r1", "r2")
    server.world.spawn(a_spawn("camera", model=msgspec.structs.replace(a_cart(), drive=None)))
    server.world.claim("a", ("r1", "camera"), "stop")
    server.drive("a", *[0.0] * server.world.claimed_by_agent()["a"].target_count)

    server.turn_for(0.1)

    found = read(server)
    assert (found["zensim_entities", "robot"], found["zensim_entities", "object"]) == (2, 1)
    assert (found["zensim_claimed_robots",], found["zensim_driven_robots",]) == (1, 1)


def test_number_of_series_does_not_depend_on_robots() -> None:
    few, many = a_server("r1"), a_server(*(f"r{number}" for number in range(1000)))

    assert read(few).keys() == read(many).keys()


def test_series_stay_few_with_all_services_and_more_results_than_are_counted() -> None:
    server = a_server("r1")
    for name in (*NAMES, *(f"unknown_{number}" for number in range(10))):
        for code in range(10):
            response = Refused(Result(code, ""))
            server.loop.request_counts.add(name, response, 1_000_000)

    assert len(read(server)) + SERIES_OF_JOURNAL_AND_PROCESS <= MAX_SERIES


def test_file_sizes_are_those_of_the_folder_itself(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(10))
    (tmp_path / "b").write_bytes(bytes(5))
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "c").write_bytes(bytes(100))

    assert sum_file_sizes(str(tmp_path)) == 15
    assert sum_file_sizes(str(tmp_path / "missing")) == 0
