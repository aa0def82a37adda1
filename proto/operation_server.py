"""Health checks and metrics of a program by http: /livez, /readyz, /healthz and /metrics."""

from __future__ import annotations

import logging
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib.metadata import version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from zensim.proto.bounded_http_server import BoundedHttpRequest, BoundedHttpServer
from zensim.proto.metric_families import MetricFamily, MetricSample
from zensim.proto.metrics_address import UnusableMetrics, parse_metrics_address

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client import CollectorRegistry
    from prometheus_client.core import Metric

    from zensim.proto.program_status import HealthCheck, ProgramStatus

EXTRA: Final = "prometheus_client"
TEXT_TYPE: Final = "text/plain; charset=utf-8"
CONNECTION_S: Final = 5.0
"""Wall time of a connection at most: clients that hold them must not keep probes out for long."""
LOG = logging.getLogger(__name__)


class FamilyCollector:
    """Hands metrics of a program to the client library of Prometheus, as it asks for them."""

    def __init__(self, status: ProgramStatus) -> None:
        self._status = status

    def collect(self) -> Iterator[Metric]:
        """List the metrics now."""
        from prometheus_client.core import Metric  # noqa: PLC0415

        labels = {"world": self._status.world}
        for family in (make_build_info(), *self._status.list_metrics()):
            base = family.name.removesuffix("_total") if family.kind == "counter" else family.name
            found = Metric(base, family.documentation, family.kind)
            for one in family.samples:
                found.add_sample(family.name + one.suffix, {**labels, **one.labels}, one.value)
            yield found


def make_build_info() -> MetricFamily:
    """Make the family that names the version."""
    sample = MetricSample(1.0, {"version": version("zensim")})
    return MetricFamily("zensim_build_info", "gauge", "Version of zensim.", (sample,))


def make_registry(status: ProgramStatus) -> CollectorRegistry:
    """Make the registry of a program: its metrics, and those of its process.

    Raises:
        UnusableMetrics: The client library is not installed.
    """
    if find_spec(EXTRA) is None:
        raise UnusableMetrics(f"{EXTRA} is not installed; use pip install 'zensim[metrics]'")
    from prometheus_client import CollectorRegistry, ProcessCollector  # noqa: PLC0415

    registry = CollectorRegistry(auto_describe=False)
    ProcessCollector(registry=registry)
    registry.register(FamilyCollector(status))
    return registry


class OperationServer(BoundedHttpServer):
    """Serves the status of a program in threads; the program never waits for it."""

    longest_s = CONNECTION_S

    def __init__(self, host: str, port: int, status: ProgramStatus) -> None:
        """Listen, and serve from now on.

        Raises:
            OSError: The address cannot be used.
            UnusableMetrics: The client library is not installed.
        """
        self.status = status
        self.registry = make_registry(status)
        super().__init__(host, port, StatusRequest)
        self.start("operation")


class StatusRequest(BoundedHttpRequest, BaseHTTPRequestHandler):
    """A request for the status of a program."""

    server: OperationServer

    def do_GET(self) -> None:
        """Send a page."""
        path, status = urlsplit(self.path).path, self.server.status
        pages: dict[str, Callable[[], None]] = {
            "/livez": lambda: self._send_check(status.check_alive()),
            "/healthz": lambda: self._send_check(status.check_alive()),
            "/readyz": lambda: self._send_check(status.check_ready()),
            "/metrics": self._send_metrics,
        }
        if (send := pages.get(path)) is None:
            self._send(HTTPStatus.NOT_FOUND, TEXT_TYPE, f"{' '.join(pages)}\n".encode())
        else:
            send()

    def do_HEAD(self) -> None:
        """Send the head of a page."""
        self.do_GET()

    def _send_check(self, check: HealthCheck) -> None:
        code = HTTPStatus.SERVICE_UNAVAILABLE if check.fault else HTTPStatus.OK
        self._send(code, TEXT_TYPE, f"{check.line}\n".encode())

    def _send_metrics(self) -> None:
        from prometheus_client import CONTENT_TYPE_LATEST, generate_latest  # noqa: PLC0415

        try:
            text = generate_latest(self.server.registry)
        except Exception as error:
            # Counters are read while another thread writes them, and health must not depend on it.
            LOG.exception("metrics cannot be read")
            self._send(HTTPStatus.INTERNAL_SERVER_ERROR, TEXT_TYPE, f"{error!r}\n".encode())
            return
        self._send(HTTPStatus.OK, CONTENT_TYPE_LATEST, text)

    def _send(self, code: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


def open_operation_server(address: str, status: ProgramStatus) -> OperationServer:
    """Serve the status of a program until it is closed.

    Args:
        address: `[HOST:]PORT` of `--metrics`.
        status: Of the program.

    Raises:
        UnusableMetrics: The address cannot be used, or the client library is not installed.
    """
    host, port = parse_metrics_address(address)
    try:
        return OperationServer(host, port, status)
    except OSError as error:
        raise UnusableMetrics(
            f"`metrics` {address} cannot be used: {error.strerror}; use another port"
        ) from error
