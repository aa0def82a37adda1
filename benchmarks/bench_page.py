"""Cost of the 3D page

The process of `zensim view` beside a server whose robots drive circles in real time, or stand; 1000
robots with `--dynamics auto --step-hz 100`, as PyBullet is too slow for that with full dynamics.
Visitors are programs that read all that a browser would get, on the same cores. CPU and bytes are
those of each second, of the page's process and of one visitor. The search is what a visitor does:
press a row of the list, and see the camera move. The browser is Chromium with WebGL in software, on
the same cores; its first visit is that of a new profile.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import msgspec
import psutil

from benchmarks.figures import Figure, table
from benchmarks.fleet_server import PATIENCE_S, FleetServer, program, run_fleet_server
from benchmarks.machine import used_s
from benchmarks.page_visitor import Second
from tests.integration.chromium import Chromium
from tests.integration.page_drawing import HAS_ROBOTS, count_frames
from tests.integration.page_user import PageUser
from tests.integration.processes import eventually, running
from zensim.proto.messages.simulation_messages import State

__all__ = ["rows", "table"]

SECONDS, SECONDS_WHEN_SHORT = 20, 1
WARM_UP_S, WARM_UP_WHEN_SHORT_S = 5.0, 0.0
FLEETS, FLEETS_WHEN_SHORT = (10, 100, 1000), (3,)
MANY = 1000
"""Robots from which on a fleet is large."""
OF_MANY = ("--dynamics", "auto", "--step-hz", "100")
"""Options of large fleets: with full dynamics a step of them takes more time than it simulates, and
no page gets more snapshots than there are steps."""
VISITORS = 5
KILOBYTES, MEGABYTES = 1e-3, 1e-6
SEARCHES = 20
POLL_S = 0.001


@dataclass(frozen=True)
class Page:
    """A page and the process that serves it."""

    url: str
    pid: int
    robots: int
    is_short: bool

    @property
    def seconds(self) -> int:
        """Number of samples."""
        return SECONDS_WHEN_SHORT if self.is_short else SECONDS

    def measure_cores(self) -> tuple[float, ...]:
        """Measure the CPU of the page in each second while no browser has it open."""
        time.sleep(WARM_UP_WHEN_SHORT_S if self.is_short else WARM_UP_S)
        return tuple(self._measure_second() for _ in range(self.seconds))

    def measure_visits(self, count: int) -> "Visits":
        """Measure the page in each second while visitors have it open."""
        with program("page_visitor", self.url, str(count)) as process:
            assert process.stdout is not None
            skipped = round(WARM_UP_WHEN_SHORT_S if self.is_short else WARM_UP_S)
            before_s = before_at = 0.0
            cores, seconds = [], []
            for number in range(skipped + 1 + self.seconds):
                second = msgspec.json.decode(process.stdout.readline(), type=Second)
                used, now = used_s(self.pid), time.perf_counter()
                if number > skipped:
                    cores.append((used - before_s) / (now - before_at))
                    seconds.append(second)
                before_s, before_at = used, now
            memory = psutil.Process(self.pid).memory_info().rss
        return Visits(tuple(cores), tuple(seconds), memory)

    def _measure_second(self) -> float:
        before_s, before_at = used_s(self.pid), time.perf_counter()
        time.sleep(1.0)
        return (used_s(self.pid) - before_s) / (time.perf_counter() - before_at)


@dataclass(frozen=True)
class Visits:
    """What a page used, and what its visitors got."""

    cores: tuple[float, ...]
    seconds: tuple[Second, ...]
    memory_bytes: float


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the page without visitors, with one and with five, and a search."""
    for robots in FLEETS_WHEN_SHORT if is_short else FLEETS:
        with (
            run_fleet_server(robots, "--rtf", "1", *_choose_options(robots)) as server,
            _serve_page(server.endpoint) as (url, pid),
        ):
            page = Page(url, pid, robots, is_short)
            yield from _measure_standing(page)
            server.client.set_simulation_state(State.PLAYING)
            yield from _measure_driving(page)
            yield _read_factor(page, server)
            yield from _measure_search(page)
            yield from _measure_drawing(page)


def _choose_options(robots: int) -> tuple[str, ...]:
    return OF_MANY if robots >= MANY else ()


def _read_factor(page: Page, server: FleetServer) -> Figure:
    """Read the real-time factor, which says whether the server gives as much as it should."""
    what = f"{page.robots} robots drive: real-time factor of the server"
    return Figure(what=what, unit="", samples=(server.client.info().real_time_factor,))


@contextmanager
def _serve_page(endpoint: str) -> Iterator[tuple[str, int]]:
    with running("view", "--connect", endpoint, "--port", "0") as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1], process.pid


def _measure_standing(page: Page) -> Iterator[Figure]:
    what = f"{page.robots} robots stand, the world is paused"
    visits = page.measure_visits(1)
    yield from _make_costs(f"{what}, one visitor", visits)
    first = (visits.seconds[0].first_bytes * KILOBYTES,)
    yield Figure(what=f"{what}: first load of the scene", unit="kB", samples=first)


def _measure_driving(page: Page) -> Iterator[Figure]:
    what = f"{page.robots} robots drive"
    cores = page.measure_cores()
    yield Figure(what=f"{what}, no visitor: CPU of the page", unit="cores", samples=cores)
    for count, visitors in ((1, "one visitor"), (VISITORS, f"{VISITORS} visitors")):
        visits = page.measure_visits(count)
        updates = tuple(second.updates for second in visits.seconds)
        yield Figure(what=f"{what}, {visitors}: updates a second", unit="", samples=updates)
        yield from _make_costs(f"{what}, {visitors}", visits)
        memory = (visits.memory_bytes * MEGABYTES,)
        yield Figure(what=f"{what}, {visitors}: memory", unit="MB", samples=memory)


def _make_costs(what: str, visits: Visits) -> Iterator[Figure]:
    yield Figure(what=f"{what}: CPU of the page", unit="cores", samples=visits.cores)
    sent = tuple(second.bytes * KILOBYTES for second in visits.seconds)
    yield Figure(what=f"{what}: sent a second", unit="kB", samples=sent)


def _measure_search(page: Page) -> Iterator[Figure]:
    """Choose robots in the list; measure until the camera moves."""
    delays = []
    with PageUser(page.url) as user:
        user.wait_for_row("box_bot0")
        for number in range(min(SEARCHES, page.robots)):
            delays.append(_time_search(user, f"box_bot{page.robots - 1 - number}"))
            _stop_following(user)
    what = f"{page.robots} robots drive: name given, row pressed, camera moves"
    yield Figure(what=what, unit="ms", samples=tuple(delays))


def _time_search(user: PageUser, name: str) -> float:
    """Select an entity of the list; return the time [ms] until the camera moves."""
    began, before = time.perf_counter(), user.camera_messages
    user.send("ZensimSelect", entity=name)
    while user.camera_messages == before:
        if time.perf_counter() >= began + PATIENCE_S:
            raise TimeoutError(f"no camera that moves to {name} within {PATIENCE_S:g} s")
        time.sleep(POLL_S)
    return 1e3 * (time.perf_counter() - began)


def _stop_following(user: PageUser) -> None:
    user.press("Stop following")
    eventually(lambda: "Stop following" not in user.list_labels(), 10.0, "no selection")


def _measure_drawing(page: Page) -> Iterator[Figure]:
    """Open the page twice in a new browser; count frames at 1280x800 while robots drive."""
    what = f"{page.robots} robots drive, in a browser"
    with Chromium() as browser:
        tab = browser.tab()
        for visit in ("first", "second"):
            tab.call("Page.navigate", url="about:blank")
            began = time.perf_counter()
            tab.open(page.url, "")
            tab.until(HAS_ROBOTS, PATIENCE_S)
            seconds = (time.perf_counter() - began,)
            yield Figure(what=f"{what}: first robot, {visit} visit", unit="s", samples=seconds)
        time.sleep(WARM_UP_WHEN_SHORT_S if page.is_short else WARM_UP_S)
        frames = count_frames(tab, page.seconds)
    yield Figure(what=f"{what}: frames a second", unit="", samples=frames)
