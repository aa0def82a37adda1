"""Health and metrics of real processes: server, pool, sensors, recorder."""

from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from tests.deploy.monitoring_rules import find_metrics, list_alert_queries, list_dashboard_queries
from tests.integration.processes import Server, eventually, free_endpoint, running, serving, zensim
from tests.integration.scraping import find_free_port, list_metric_names, probe, scrape
from zensim.proto.exit_codes import ExitCode

WITHIN_S = 30.0
ROBOTS = 3
MAX_SERIES = 300


class Programs:
    """Ports of a server and of what runs beside it."""

    def __init__(self) -> None:
        self.ports = {name: find_free_port() for name in ("server", "pool", "sensors", "recorder")}
        self.server: Server


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Programs]:
    folder = tmp_path_factory.mktemp("operation")
    found = Programs()
    ports = found.ports
    with ExitStack() as stack:
        journal = ("--journal", str(folder / "journal"))
        found.server = stack.enter_context(serving("--metrics", ports["server"], *journal))
        at = ("--connect", found.server.endpoint)
        spawned = found.server.zensim("fleet", "box_bot", "--robots", str(ROBOTS))
        assert spawned.returncode == ExitCode.OK, spawned.stderr
        for name, words in {
            "pool": ("agent", "--pool", "0"),
            "sensors": ("sensors", "run"),
            "recorder": ("record", "--all", "-o", str(folder / "run.mcap")),
        }.items():
            stack.enter_context(running(*words, "--metrics", ports[name], *at))
        yield found


@pytest.mark.parametrize("name", ["server", "pool", "sensors", "recorder"])
def test_program_is_alive_and_ready(programs: Programs, name: str) -> None:
    port = programs.ports[name]

    eventually(lambda: probe(port, "/readyz") == 200, WITHIN_S, "readiness")

    assert probe(port, "/livez") == probe(port, "/healthz") == probe(port, "/metrics") == 200
    assert probe(port, "/") == 404


@pytest.mark.parametrize(
    ("name", "metric", "least"),
    [
        ("server", ("zensim_entities", "robot"), ROBOTS),
        ("server", ("zensim_claimed_robots",), ROBOTS),
        ("server", ("zensim_agents",), 1),
        ("server", ("zensim_steps_total",), 100),
        ("server", ("zensim_commands_received_total",), 100),
        ("server", ("zensim_requests_total", "OK", "spawn_entities"), 1),
        ("server", ("zensim_journal_commit_seconds_count",), 1),
        ("server", ("zensim_journal_bytes",), 1000),
        ("server", ("zensim_bus_messages_total", "received"), 100),
        ("pool", ("zensim_agent_robots",), ROBOTS),
        ("pool", ("zensim_agent_commands_total",), 100),
        ("pool", ("zensim_agent_cycle_seconds_count",), 100),
        ("pool", ("zensim_bus_bytes_total", "sent"), 1000),
        ("sensors", ("process_cpu_seconds_total",), 0.01),
        ("recorder", ("zensim_recorder_messages_total",), 100),
        ("recorder", ("zensim_recorder_topics",), ROBOTS),
        ("recorder", ("process_cpu_seconds_total",), 0.01),
    ],
)
def test_metric_grows_with_what_the_program_does(
    programs: Programs, name: str, metric: tuple[str, ...], least: float
) -> None:
    port = programs.ports[name]
    eventually(lambda: probe(port, "/readyz") == 200, WITHIN_S, "readiness")

    eventually(lambda: scrape(port).get(metric, 0.0) >= least, WITHIN_S, str(metric))


@pytest.mark.parametrize("name", ["server", "pool", "sensors", "recorder"])
def test_series_are_few(programs: Programs, name: str) -> None:
    eventually(lambda: probe(programs.ports[name], "/readyz") == 200, WITHIN_S, "readiness")

    assert len(scrape(programs.ports[name])) <= MAX_SERIES


def is_ready(port: str) -> bool:
    return probe(port, "/readyz") == 200


def test_metrics_of_alerts_and_dashboard_are_those_of_the_programs(programs: Programs) -> None:
    for port in programs.ports.values():
        eventually(partial(is_ready, port), WITHIN_S, "readiness")
    queries = [*list_alert_queries(), *list_dashboard_queries()]

    found = set().union(*map(list_metric_names, programs.ports.values()))

    assert set().union(*map(find_metrics, queries)) - found == set()


def test_agent_that_waits_for_a_server_is_alive_and_not_ready() -> None:
    port = find_free_port()
    waiting = ("--connect", free_endpoint(), "--wait", "60")

    with running("agent", "r1", "--metrics", port, *waiting):
        eventually(lambda: probe(port, "/livez") == 200, WITHIN_S, "life")
        assert probe(port, "/readyz") == 503


@pytest.mark.parametrize("address", ["nowhere", "70000"])
def test_address_that_is_none_ends_the_start(address: str, tmp_path: Path) -> None:
    done = zensim("serve", "--metrics", address, "--journal", str(tmp_path / "journal"))

    assert done.returncode == ExitCode.USAGE
    assert len(done.stderr.splitlines()) == 1
