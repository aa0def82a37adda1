"""Security

Two sessions over a router in a process of its own, in turn plain TCP, and TLS with user, password
and the access rules of all roles. A get is answered by a thread of this process; messages have
100 bytes. Each ratio is that of a pair measured one after the other.
"""

import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks.figures import Figure, Limit, table
from zensim.proto.bus import Bus, BusConfig, open_bus, open_bus_with_retry
from zensim.proto.endpoints import with_free_port
from zensim.proto.keys import last_chunk
from zensim.proto.supervisor import Supervisor
from zensim.sim_server.security.router_process import secured_router
from zensim.sim_server.security.secure_folder import SecureSettings, prepare_secure_folder

__all__ = ["rows", "table"]

WORLD = "benchmark"
TOPIC, SERVICE = f"sim/{WORLD}/clock", f"sim/{WORLD}/info"
GETS, MESSAGES, REPEATS = 200, 10_000, 15
GETS_WHEN_SHORT, MESSAGES_WHEN_SHORT, REPEATS_WHEN_SHORT = 20, 500, 2
PAYLOAD = bytes(100)
WAIT_S = 30.0
PAUSE_S = 0.0005
WINDOW = 500
"""Messages on their way at once: a congested network drops more."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure joins, gets and message rates of both."""
    gets = GETS_WHEN_SHORT if is_short else GETS
    messages = MESSAGES_WHEN_SHORT if is_short else MESSAGES
    repeats = REPEATS_WHEN_SHORT if is_short else REPEATS
    with _plain() as plain, _secured() as (secured, token):
        get_ms = [(_get_ms(*plain, gets), _get_ms(*secured, gets)) for _ in range(repeats)]
        rates = [(_rate(*plain, messages), _rate(*secured, messages)) for _ in range(repeats)]
        joins = [_join_ms(token) for _ in range(repeats)]
    yield Figure(what="get, plain TCP", unit="ms", samples=tuple(one for one, _ in get_ms))
    yield Figure(what="get, secured", unit="ms", samples=tuple(one for _, one in get_ms))
    yield _ratio("get, secured / plain", [two / one for one, two in get_ms], "<=", 1.3)
    yield Figure(what="messages, plain TCP", unit="1/s", samples=tuple(one for one, _ in rates))
    yield Figure(what="messages, secured", unit="1/s", samples=tuple(one for _, one in rates))
    yield _ratio("messages, secured / plain", [two / one for one, two in rates], ">=", 0.8)
    yield Figure(what="join by a token, with both handshakes", unit="ms", samples=tuple(joins))


def _ratio(what: str, samples: list[float], relation: str, bound: float) -> Figure:
    limit = Limit("median", "<=" if relation == "<=" else ">=", bound, is_timed=True)
    return Figure(what=what, unit="", samples=tuple(samples), limit=limit)


@contextmanager
def _plain() -> Iterator[tuple[Bus, Bus]]:
    endpoint = with_free_port("tcp/127.0.0.1:0")
    supervisor = Supervisor(lambda _program, _status: None)
    try:
        supervisor.start("router", ("router", "--listen", endpoint))
        config = BusConfig(connect=(endpoint,))
        with open_bus_with_retry(config, WAIT_S) as server, open_bus(config) as client:
            yield server, client
    finally:
        supervisor.close()


@contextmanager
def _secured() -> Iterator[tuple[tuple[Bus, Bus], str]]:
    with ExitStack() as stack:
        state = stack.enter_context(tempfile.TemporaryDirectory())
        before = os.environ.get("XDG_STATE_HOME")
        os.environ["XDG_STATE_HOME"] = str(Path(state))
        stack.callback(_restore, before)
        endpoint = with_free_port("tls/127.0.0.1:0")
        folder = prepare_secure_folder(SecureSettings(WORLD, 0, endpoint))
        router = stack.enter_context(secured_router(folder, "bench"))
        server = stack.enter_context(open_bus(router.wait()))
        token = folder.make_token(folder.accounts()["observer"]).write()
        client = stack.enter_context(open_bus(BusConfig(connect=(token,))))
        yield (server, client), token


def _restore(state_home: str | None) -> None:
    if state_home is None:
        del os.environ["XDG_STATE_HOME"]
    else:
        os.environ["XDG_STATE_HOME"] = state_home


def _get_ms(server: Bus, client: Bus, count: int) -> float:
    """Measure the mean time of a get [ms]."""
    queue, is_over = server.serve(SERVICE), threading.Event()

    def answer() -> None:
        while not is_over.is_set():
            for query in queue.take():
                query.reply(last_chunk(query.key).encode(), "")
            time.sleep(PAUSE_S / 10)

    thread = threading.Thread(target=answer)
    thread.start()
    while not client.get(SERVICE):
        time.sleep(PAUSE_S)
    began_s = time.perf_counter()
    for _ in range(count):
        client.get(SERVICE)
    spent_s = time.perf_counter() - began_s
    is_over.set()
    thread.join()
    queue.close()
    return spent_s / count * 1e3


def _rate(server: Bus, client: Bus, count: int) -> float:
    """Measure messages of the server that reach a client in a second."""
    publisher, subscription = server.advertise(TOPIC, ""), client.subscribe(TOPIC, depth=count)
    while subscription.newest() is None:
        publisher.send(PAYLOAD)
        time.sleep(PAUSE_S)
    time.sleep(PAUSE_S)
    subscription.take()
    began_s, received, sent = time.perf_counter(), 0, 0
    while received < count and time.perf_counter() - began_s < WAIT_S:
        while sent < count and sent - received < WINDOW:
            publisher.send(PAYLOAD)
            sent += 1
        received += len(subscription.take())
    spent_s = time.perf_counter() - began_s
    publisher.close()
    subscription.close()
    return received / spent_s


def _join_ms(token: str) -> float:
    began_s = time.perf_counter()
    open_bus(BusConfig(connect=(token,))).close()
    return (time.perf_counter() - began_s) * 1e3
