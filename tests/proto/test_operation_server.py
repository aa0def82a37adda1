"""Health and metrics by http, as a client of Prometheus reads them."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from http.client import HTTPConnection

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.integration.processes import eventually
from zensim.proto.bounded_http_server import IDLE_S, MAX_CONNECTIONS
from zensim.proto.bus_traffic import BusTraffic
from zensim.proto.metric_families import DurationHistogram, MetricFamily, make_counter
from zensim.proto.metrics_address import UnusableMetrics
from zensim.proto.operation_server import OperationServer
from zensim.proto.program_status import ProgramStatus
from zensim.proto.served_status import served_status

HISTOGRAM = DurationHistogram()
HISTOGRAM.add(3_000_000)


@pytest.fixture
def status() -> ProgramStatus:
    status = ProgramStatus()
    status.world = "lab"
    return status


@pytest.fixture
def server(status: ProgramStatus) -> Iterator[OperationServer]:
    with served_status("0", status) as found:
        assert found is not None
        yield found


def get(server: OperationServer, path: str) -> tuple[int, str]:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=10.0)
    connection.request("GET", path)
    response = connection.getresponse()
    found = response.status, response.read().decode()
    connection.close()
    return found


@pytest.mark.parametrize("path", ["/livez", "/metrics", "/none"])
def test_head_is_that_of_the_page_without_its_body(server: OperationServer, path: str) -> None:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=10.0)
    connection.request("HEAD", path)
    response = connection.getresponse()

    assert response.status == get(server, path)[0]
    assert int(response.headers["Content-Length"]) > 0
    assert response.read() == b""
    connection.close()


def test_nothing_is_served_without_an_address(status: ProgramStatus) -> None:
    with served_status("", status) as server:
        assert server is None


def test_port_in_use_is_refused(server: OperationServer) -> None:
    with pytest.raises(UnusableMetrics), served_status(str(server.port), ProgramStatus()):
        pass


def test_checks_follow_the_phases_of_the_program(
    server: OperationServer, status: ProgramStatus
) -> None:
    starting = get(server, "/readyz")[0]
    status.note_turn()
    ready = get(server, "/readyz")
    status.drain()

    assert (starting, ready) == (503, (200, "[+] phase: ok\n"))
    assert get(server, "/readyz")[0] == 503
    assert get(server, "/livez") == get(server, "/healthz") == (200, "[+] loop: ok\n")


def test_stuck_loop_is_not_alive(server: OperationServer) -> None:
    times = iter([0.0, 6.0, 6.0])
    stuck = ProgramStatus(lambda: next(times))
    stuck.note_turn()
    server.status = stuck

    assert get(server, "/livez")[0] == 503
    assert get(server, "/healthz")[0] == 503


def test_unknown_path_is_not_found(server: OperationServer) -> None:
    assert get(server, "/")[0] == 404


def test_metrics_that_cannot_be_read_are_an_error_and_life_goes_on(
    server: OperationServer, status: ProgramStatus, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> list[MetricFamily]:
        raise RuntimeError("dictionary changed size during iteration")

    status.sources.append(fail)

    code, _ = get(server, "/metrics")

    assert code == 500
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert get(server, "/livez")[0] == 200


def test_connections_that_are_held_leave_room_for_probes_soon(server: OperationServer) -> None:
    with ExitStack() as stack:
        for _ in range(MAX_CONNECTIONS):
            held = stack.enter_context(socket.create_connection(("127.0.0.1", server.port), 10.0))
            held.sendall(b"G")
        eventually(lambda: server.count_connections() == MAX_CONNECTIONS, 10.0, "connections")
        server.longest_s = 0.0
        eventually(lambda: server.count_connections() == 0, 10.0, "their end")
        del server.longest_s

        assert get(server, "/livez")[0] == 200
    assert type(server).longest_s <= IDLE_S


def test_metrics_are_what_a_client_of_prometheus_reads(
    server: OperationServer, status: ProgramStatus
) -> None:
    traffic = BusTraffic()
    traffic.sent, traffic.received_bytes = 3, 70
    status.sources += [
        lambda: [make_counter("zensim_late_steps_total", "Late.", 2)],
        lambda: [HISTOGRAM.make_family("zensim_step_duration_seconds", "Time.")],
        traffic.list_metrics,
    ]

    code, text = get(server, "/metrics")

    families = {one.name: one for one in text_string_to_metric_families(text)}
    values = {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in families.values()
        for sample in family.samples
    }
    world = ("world", "lab")
    assert code == 200
    assert families["zensim_late_steps"].type == "counter"
    assert families["zensim_step_duration_seconds"].type == "histogram"
    assert values["zensim_late_steps_total", world] == 2
    assert values["zensim_step_duration_seconds_bucket", ("le", "0.005"), world] == 1
    assert values["zensim_step_duration_seconds_sum", world] == 0.003
    assert values["zensim_bus_messages_total", ("direction", "sent"), world] == 3
    assert values["zensim_bus_bytes_total", ("direction", "received"), world] == 70
    assert "process_cpu_seconds" in families
    assert "zensim_build_info" in families


@pytest.mark.parametrize("path", ["/livez", "/metrics", "/"])
@pytest.mark.parametrize(
    "headers", [{"Host": "evil.example"}, {"Host": ""}, {"Origin": "http://evil.example"}]
)
def test_page_of_another_site_reads_nothing(
    server: OperationServer, path: str, headers: dict[str, str]
) -> None:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=10.0)
    connection.request("GET", path, headers=headers)

    assert connection.getresponse().status == 403
    connection.close()
