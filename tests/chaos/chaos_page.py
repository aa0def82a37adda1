"""Page

Pages open, move their camera and close again, 30 at a time; 20 more never read what they get; one
sends mutated messages. Ten robots drive meanwhile. Then the page's process is killed with SIGKILL,
and restarted by `zensim up`. All clients run in one process on the same host, and use its cores.
"""

import asyncio
import json
import os
import random
import signal
import sys
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from urllib.error import URLError

import psutil
from websockets.asyncio.client import ClientConnection as AsyncConnection
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.sync.client import ClientConnection
from websockets.typing import Origin

from benchmarks.figures import Figure, Limit
from tests.integration.page_client import (
    PROTOCOL,
    connect_page,
    encode_act,
    encode_camera,
    encode_click,
    encode_drive,
    encode_selection,
    encode_update,
    find_control,
)
from tests.integration.processes import START_S, eventually, kill, running_up
from zensim.proto.bus.bus_session import Bus
from zensim.spawner.client.sim_client import SimClient

ROBOTS, ROBOTS_WHEN_SHORT = 10, 2
VISITORS, VISITORS_WHEN_SHORT = 100, 6
MUTE, MUTE_WHEN_SHORT = 20, 1
LASTS_S, LASTS_WHEN_SHORT_S = 600.0, 1.0
MUTANTS, MUTANTS_WHEN_SHORT = 100_000, 50
SENDERS, SENDERS_WHEN_SHORT = 40, 2
STAY_S = (0.1, 1.5)
"""Shortest and longest visit."""
SETTLE_S = 3.0
"""For the scene to reach new pages."""
KILLS, KILLS_WHEN_SHORT = 5, 1
MEGABYTE = 1e6


@dataclass
class Visits:
    """Visits to a page by tasks of one thread."""

    url: str
    seed: int
    opened: int = 0
    refused: int = 0
    broken: list[str] = field(default_factory=list)
    """What ended visits that their visitors did not end."""

    async def visit(self, number: int) -> None:
        """Open and close the page until the task is cancelled."""
        chance = random.Random(self.seed + number)
        while True:
            await self._stay(chance)

    async def _stay(self, chance: random.Random) -> None:
        try:
            await self._open_and_close(chance)
        except InvalidStatus:
            self.refused += 1
            await asyncio.sleep(chance.uniform(*STAY_S))
        except (OSError, InvalidHandshake, ConnectionClosed, TimeoutError) as error:
            self.broken.append(repr(error))
            await asyncio.sleep(1.0)

    async def _open_and_close(self, chance: random.Random) -> None:
        async with connect_async(
            self.url.replace("http", "ws"),
            subprotocols=[PROTOCOL],
            origin=Origin(self.url),
            max_size=None,
        ) as page:
            self.opened += 1
            await page.send(encode_camera())
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(_read(page), chance.uniform(*STAY_S))


async def _read(page: AsyncConnection) -> None:
    async for _ in page:
        pass


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Load a page, then kill it."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    with running_up("--robots", str(robots), "--port", "0") as (process, ready, bus):
        url = str(ready["viewer"])
        yield from _load(bus, url, process.pid, is_short=is_short)
        yield from _kill(url, process.pid, KILLS_WHEN_SHORT if is_short else KILLS)


def _load(bus: Bus, url: str, up: int, *, is_short: bool) -> Iterator[Figure]:
    client = SimClient(bus, "default")
    page = _find_page(up)
    eventually(lambda: client.info().sim_time_s > 2.0, START_S, "driving robots")
    with closing(connect_page(url)) as first:
        first.send(encode_camera())
        buttons = find_control(first, "GuiButtonGroupMessage")
    before_mb = _find_memory_mb(page)
    began, began_s = client.info(), time.monotonic()
    visits = Visits(url, seed=1)
    with ExitStack() as mute:
        for _ in range(MUTE_WHEN_SHORT if is_short else MUTE):
            mute.enter_context(closing(connect_page(url))).send(encode_camera())
        with _visited(visits, VISITORS_WHEN_SHORT if is_short else VISITORS):
            time.sleep(LASTS_WHEN_SHORT_S if is_short else LASTS_S)
        lasted_s = time.monotonic() - began_s
        factor = (client.info().sim_time_s - began.sim_time_s) / lasted_s
        _press_pause(client, url)
    sys.stderr.write(f"broken off: {Counter(visits.broken)}\n")
    visited_mb = _find_memory_mb(page) - before_mb
    mutants = MUTANTS_WHEN_SHORT if is_short else MUTANTS
    senders = SENDERS_WHEN_SHORT if is_short else SENDERS
    mutated_mb = _send_mutants(page, url, buttons, mutants, senders)
    _press_pause(client, url)
    is_same = float(_find_page(up) == page)
    yield Figure(
        what=f"real-time factor, {visits.opened} visits in {lasted_s:.0f} s "
        f"({visits.refused} refused at the limit)",
        unit="",
        samples=(factor,),
        limit=Limit("min", ">=", 0.98, is_timed=True),
    )
    yield Figure(
        what="visits that the page broke off",
        unit="",
        samples=(float(len(visits.broken)),),
        limit=Limit("max", "<=", 0.0),
    )
    yield Figure(
        what=f"page of the start serves, and its buttons work, after {mutants} mutated messages",
        unit="",
        samples=(is_same,),
        limit=Limit("min", ">=", 1.0),
    )
    yield Figure(
        what="memory of the page after the visits, more than before",
        unit="MB",
        samples=(visited_mb,),
    )
    yield Figure(
        what="memory of the page after the mutated messages, more than before them",
        unit="MB",
        samples=(mutated_mb,),
        limit=Limit("max", "<=", 5.0),
    )


@contextmanager
def _visited(visits: Visits, visitors: int) -> Iterator[None]:
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    tasks = [asyncio.run_coroutine_threadsafe(visits.visit(n), loop) for n in range(visitors)]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        asyncio.run_coroutine_threadsafe(_end_tasks(), loop).result(START_S)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(START_S)
        loop.close()


async def _end_tasks() -> None:
    others = asyncio.all_tasks() - {asyncio.current_task()}
    await asyncio.gather(*others, return_exceptions=True)


def _press_pause(client: SimClient, url: str) -> None:
    """Pause and play by the page; other services of the server are not involved."""
    for button, state in (("Pause", "paused"), ("Play", "playing")):

        def is_reached(button: str = button, state: str = state) -> bool:
            with suppress(InvalidStatus, OSError), closing(connect_page(url)) as page:
                page.send(encode_camera())
                find_control(page, "GuiButtonGroupMessage")  # this visitor may act now
                page.send(encode_act(button))
                return _has_state(client, state)
            return False

        eventually(is_reached, START_S, f"the state after {button}")


def _has_state(client: SimClient, state: str) -> bool:
    deadline = time.monotonic() + 1.0
    while time.monotonic() < deadline:
        if client.info().state == state:
            return True
    return False


def _send_mutants(page: int, url: str, buttons: str, mutants: int, senders: int) -> float:
    """Send mutated messages over several links, each of which is read at 60 messages a second.

    Returns:
        Memory of the page afterwards, more than with as many links before [MB].
    """
    chance = random.Random(2)
    originals = (
        *(encode_camera(), encode_click("/robots/0/0", 1), encode_update(buttons, value=1)),
        *(encode_act("Step"), encode_selection("r1"), encode_drive(0.1)),
    )
    with ExitStack() as stack:
        links = [stack.enter_context(closing(connect_page(url))) for _ in range(senders)]
        threads = [
            threading.Thread(target=_send_all, args=(link, _mutate(chance, originals, share)))
            for link, share in zip(links, _split(mutants, senders), strict=True)
        ]
        for link in links:
            link.send(encode_camera())
            threading.Thread(target=_drain, args=(link,), daemon=True).start()
        time.sleep(SETTLE_S)
        before_mb = _find_memory_mb(page)
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return _find_memory_mb(page) - before_mb


def _split(total: int, parts: int) -> list[int]:
    return [total // parts] * (parts - 1) + [total - total // parts * (parts - 1)]


def _mutate(chance: random.Random, originals: tuple[bytes, ...], count: int) -> list[bytes]:
    mutants = []
    for _ in range(count):
        mutant = bytearray(chance.choice(originals))
        for _ in range(chance.randint(1, 6)):
            mutant[chance.randrange(len(mutant))] = chance.randrange(256)
        mutants.append(bytes(mutant))
    return mutants


def _send_all(link: ClientConnection, messages: list[bytes]) -> None:
    for message in messages:
        link.send(message)


def _drain(link: ClientConnection) -> None:
    with suppress(ConnectionClosed):
        for _ in link:
            pass


def _kill(url: str, up: int, kills: int) -> Iterator[Figure]:
    took_s = []
    for _ in range(kills):
        page = _find_page(up)
        kill(page, signal.SIGKILL)
        killed_s = time.monotonic()
        eventually(lambda: _is_served(url), START_S, "the page again")
        took_s.append(time.monotonic() - killed_s)
    yield Figure(
        what="page again after SIGKILL",
        unit="s",
        samples=tuple(took_s),
        limit=Limit("max", "<=", 3.0, is_timed=True),
    )


def _is_served(url: str) -> bool:
    with suppress(URLError, OSError), urllib.request.urlopen(f"{url}/names", timeout=1.0) as found:
        return isinstance(json.load(found), dict)
    return False


def _find_page(up: int) -> int:
    def find() -> int | None:
        for child in psutil.Process(up).children(recursive=True):
            with suppress(psutil.Error):
                if "view" in child.cmdline() and child.pid != os.getpid():
                    return int(child.pid)
        return None

    return eventually(find, START_S, "the process of the page")


def _find_memory_mb(pid: int) -> float:
    return float(psutil.Process(pid).memory_info().rss / MEGABYTE)
