"""Health and metrics

A server that plays with a fleet of kinematic robots and a pool, asked by http once after another as
a probe and a Prometheus do, on connections of their own. The floor is an http server that does
nothing, in a thread of the asking process, with an answer of the same length. At last, servers with
a journal get SIGTERM: /readyz is asked again and again until it is not 200, and the end is awaited.
"""

import signal
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import spawn
from tests.integration.processes import eventually, running, serving
from tests.integration.scraping import find_free_port, probe, scrape
from zensim.proto.metric_families import DurationHistogram

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 1000, 20
REPEATS, REPEATS_WHEN_SHORT = 100, 5
COUNTS = 10_000
ENDINGS = {10: 2.0, 1000: 10.0}
"""Most seconds until the end, by the number of robots."""
MOST_READY_MS, IS_READY = 100.0, 200
PAUSE_S = 0.02
WITHIN_S = 120.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure answers of a server, and what counting costs a step."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    repeats = REPEATS_WHEN_SHORT if is_short else REPEATS
    port, pool_port = find_free_port(), find_free_port()
    with serving("--metrics", port, "--dynamics", "kinematic") as server:
        spawn(server.client, robots)
        pool = ("agent", "--pool", "0", "--metrics", pool_port, "--connect", server.endpoint)
        with running(*pool):
            eventually(lambda: server.client.info().claimed == robots, WITHIN_S, "claiming")
            length = len(_read(port, "/metrics"))
            with _trivial_server(length) as floor:
                paths = ((floor, "/"), (port, "/livez"), (port, "/readyz"), (port, "/metrics"))
                taken = [[_time_ms(*one) for one in paths] for _ in range(repeats)]
            series = len(scrape(port))
            of_pool = [_time_ms(pool_port, "/metrics") for _ in range(repeats)]
    floor_ms, live_ms, ready_ms, metrics_ms = zip(*taken, strict=True)
    yield Figure(what="floor: http server that does nothing", unit="ms", samples=floor_ms)
    yield _timed("/livez", live_ms, 50.0)
    yield _timed("/readyz", ready_ms, 50.0)
    yield _timed("/metrics of the server", metrics_ms, 20.0)
    yield _timed("/metrics of the pool", tuple(of_pool), 20.0)
    limit = Limit("max", "<=", 300.0)
    yield Figure(what=f"series with {robots} robots", unit="", samples=(series,), limit=limit)
    yield Figure(what="counting a duration", unit="us", samples=tuple(_count_us(repeats)))
    for number in (ROBOTS_WHEN_SHORT,) if is_short else ENDINGS:
        yield from _end_server(number, ENDINGS.get(number, max(ENDINGS.values())))


def _end_server(robots: int, most_s: float) -> Iterator[Figure]:
    """Let a server end that has a journal and robots."""
    port = find_free_port()
    with (
        tempfile.TemporaryDirectory() as folder,
        serving("--metrics", port, "--dynamics", "kinematic", "--journal", folder) as server,
    ):
        spawn(server.client, robots)
        server.process.send_signal(signal.SIGTERM)
        began_s = time.perf_counter()
        while probe(port, "/readyz") == IS_READY:
            pass
        ready_ms = (time.perf_counter() - began_s) * 1e3
        status = server.process.wait(WITHIN_S)
        spent_s = time.perf_counter() - began_s
    what = f"{robots} robots with a journal, SIGTERM until"
    limit = Limit("max", "<=", MOST_READY_MS, is_timed=True)
    yield Figure(what=f"{what} /readyz is not 200", unit="ms", samples=(ready_ms,), limit=limit)
    limit = Limit("max", "<=", most_s, is_timed=True)
    yield Figure(what=f"{what} the end", unit="s", samples=(spent_s,), limit=limit)
    limit = Limit("max", "<=", 0.0)
    yield Figure(what=f"{what} the end, status", unit="", samples=(float(status),), limit=limit)


def _timed(what: str, samples: tuple[float, ...], bound_ms: float) -> Figure:
    limit = Limit("median", "<=", bound_ms, is_timed=True)
    return Figure(what=what, unit="ms", samples=samples, limit=limit)


def _read(port: str, path: str) -> bytes:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=WITHIN_S) as found:
        return bytes(found.read())


def _time_ms(port: str, path: str) -> float:
    time.sleep(PAUSE_S)
    began_s = time.perf_counter()
    _read(port, path)
    return (time.perf_counter() - began_s) * 1e3


def _count_us(repeats: int) -> Iterator[float]:
    histogram = DurationHistogram()
    add: Callable[[int], None] = histogram.add
    for _ in range(repeats):
        began_s = time.perf_counter()
        for number in range(COUNTS):
            add(number * 1000)
        yield (time.perf_counter() - began_s) / COUNTS * 1e6


@contextmanager
def _trivial_server(length: int) -> Iterator[str]:
    body = bytes(length)

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", str(length))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield str(server.server_address[1])
        finally:
            server.shutdown()
            thread.join()
