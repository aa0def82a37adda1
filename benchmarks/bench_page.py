"""Cost of the 3D page

The process of `zensim view` beside a server whose robots drive circles in real time, or stand; 1000
robots with `--dynamics auto --step-hz 100`, as PyBullet is too slow for that with full dynamics.
Visitors are programs that read all that a browser would get, on the same cores. CPU and bytes are
those of each second, of the page's process and of one visitor. `more` is the CPU of a second in
which one visitor shows what is named, less the median of the seconds without it; for charts and the
lidar of a robot, of seconds in which that robot is selected. The lidar stands in a room, so that
all its rays meet a wall. The search is what a visitor does: give a name, press its row, and see the
camera move.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from typing import TypeVar

import msgspec
import psutil

from benchmarks.figures import Figure, Limit, Statistic, table
from benchmarks.fleet_server import PATIENCE_S, FleetServer, program, run_fleet_server
from benchmarks.machine import used_s
from benchmarks.page_visitor import Second
from benchmarks.ten_robots import spawn
from tests.integration.page_user import PageUser
from tests.integration.processes import connected, eventually, running, serving
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntitiesOrder, SpawnEntity
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.topic_catalog import SCAN
from zensim.sim_server.description.builtin_models import read_builtin_model

__all__ = ["rows", "table"]

SECONDS, SECONDS_WHEN_SHORT = 20, 1
WARM_UP_S, WARM_UP_WHEN_SHORT_S = 5.0, 0.0
FLEETS, FLEETS_WHEN_SHORT = (100, 1000), (3,)
MANY = 1000
"""Robots from which on the limits of large fleets hold."""
OF_MANY = ("--dynamics", "auto", "--step-hz", "100")
"""Options of large fleets: with full dynamics a step of them takes more time than it simulates, and
no page gets more snapshots than there are steps."""
VISITORS = 5
KILOBYTES, MEGABYTES = 1e-3, 1e-6
LEAST_UPDATES = 20.0
MOST_CORES = {"one": 0.10, "five": 0.25, "many": 0.15, "none": 0.005, "standing": 0.03}
MOST_KB = {"one": 600.0, "many": 5000.0, "standing": 5.0}
MOST_MB = 120.0
SHOWN = {"Trails": 0.02, "Names": 0.02, "Real-time factor": 0.02}
"""Most additional cores, by the label of what one visitor switches on; the last one is a plot."""
SHOWN_OF_ONE = {"Speed": 0.02, "Show scan": 0.03}
"""The same for what is shown of a selected robot: a plot, and its lidar of 360 rays at 10 Hz."""
LEAST_DRAWINGS = {"Speed": 4.0, "Show scan": 8.0}
MOST_SCANS = 10_000
LIDAR_BOT, LIDAR_AT, ROOM_M = "lidar_bot", (-3.0, -3.0), 3.0
WALL = """<collision name="{name}"><pose>{x} {y} 0.5 0 0 0</pose><geometry><box>
<size>{length} {width} 1</size></box></geometry></collision>"""
SEARCHES = 20
MOST_SEARCH_MS = 300.0
POLL_S = 0.001
Found = TypeVar("Found")


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

    def measure_visits(self, count: int, *labels: str, entity: str = "") -> "Visits":
        """Measure the page in each second while visitors have it open."""
        with program("page_visitor", self.url, str(count), entity, *labels) as process:
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
    """Measure the page without visitors, with one, with five, and what they may show."""
    for robots in FLEETS_WHEN_SHORT if is_short else FLEETS:
        with (
            run_fleet_server(robots, "--rtf", "1", *_choose_options(robots)) as server,
            _serve_page(server.endpoint) as (url, pid),
        ):
            page = Page(url, pid, robots, is_short)
            yield from _measure_standing(page, "the world is paused")
            server.client.set_simulation_state(State.PLAYING)
            yield from _measure_driving(page)
            yield _read_factor(page, server)
            if robots < MANY:
                yield from _measure_shown_of_one(page, server)
            yield from _measure_search(page)
    if not is_short:
        yield from _measure_standing_while_time_passes(FLEETS[0])


def _measure_standing_while_time_passes(robots: int) -> Iterator[Figure]:
    with serving() as server, _serve_page(server.endpoint) as (url, pid):
        spawn(server.client, robots)
        page = Page(url, pid, robots, is_short=False)
        yield from _measure_standing(page, "time passes")


def _choose_options(robots: int) -> tuple[str, ...]:
    return OF_MANY if robots >= MANY else ()


def _read_factor(page: Page, server: FleetServer) -> Figure:
    """Read the real-time factor, which says whether the server gives as much as it should."""
    factor = server.client.info().real_time_factor
    return Figure(
        what=f"{page.robots} robots drive: real-time factor of the server",
        unit="",
        samples=(factor,),
    )


@contextmanager
def _serve_page(endpoint: str) -> Iterator[tuple[str, int]]:
    with running("view", "--connect", endpoint, "--port", "0") as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1], process.pid


def _measure_standing(page: Page, when: str) -> Iterator[Figure]:
    what = f"{page.robots} robots stand, {when}"
    visits = page.measure_visits(1)
    yield _make_cores(f"{what}, one visitor", visits.cores, MOST_CORES["standing"])
    yield _make_bytes(f"{what}, one visitor", visits, MOST_KB["standing"])
    yield Figure(
        what=f"{what}: first load of the scene",
        unit="kB",
        samples=(visits.seconds[0].first_bytes * KILOBYTES,),
    )


def _measure_driving(page: Page) -> Iterator[Figure]:
    what, is_many = f"{page.robots} robots drive", page.robots >= MANY
    yield _make_cores(f"{what}, no visitor", page.measure_cores(), MOST_CORES["none"])
    one = page.measure_visits(1)
    kind = "many" if is_many else "one"
    yield Figure(
        what=f"{what}, one visitor: updates a second",
        unit="",
        samples=tuple(second.updates for second in one.seconds),
        limit=_limit("median", ">=", LEAST_UPDATES),
    )
    yield _make_cores(f"{what}, one visitor", one.cores, MOST_CORES[kind])
    yield _make_bytes(f"{what}, one visitor", one, MOST_KB[kind])
    yield Figure(
        what=f"{what}, one visitor: memory",
        unit="MB",
        samples=(one.memory_bytes * MEGABYTES,),
        limit=_limit("max", "<=", MOST_MB) if is_many else None,
    )
    if not is_many:
        five = page.measure_visits(VISITORS)
        yield _make_cores(f"{what}, {VISITORS} visitors", five.cores, MOST_CORES["five"])
        yield from _measure_shown(page, statistics.median(one.cores))


def _measure_shown(page: Page, without: float) -> Iterator[Figure]:
    for label, most in SHOWN.items():
        cores = page.measure_visits(1, label).cores
        more = tuple(core - without for core in cores)
        yield _make_cores(f"{page.robots} robots drive, {label}, more", more, most)


def _measure_shown_of_one(page: Page, server: FleetServer) -> Iterator[Figure]:
    """Measure a plot and the scans of a robot with a lidar, beside the others that drive."""
    server.client.spawn_all(SpawnEntitiesOrder((*_order_lidar(),)))
    without = statistics.median(page.measure_visits(1, entity=LIDAR_BOT).cores)
    with running("sensors", "run", "--name", "s1", "--quiet", "--connect", server.endpoint):
        for label, most in SHOWN_OF_ONE.items():
            scans: list[float] = []
            is_scan = label == "Show scan"
            with _count_scans(server.endpoint, scans) if is_scan else nullcontext():
                visits = page.measure_visits(1, label, entity=LIDAR_BOT)
            what = f"{page.robots} robots drive, one is selected, {label}"
            more = tuple(core - without for core in visits.cores)
            yield _make_cores(f"{what}, more", more, most)
            yield Figure(
                what=f"{what}: drawings a second",
                unit="",
                samples=tuple(second.drawings for second in visits.seconds),
                limit=_limit("median", ">=", LEAST_DRAWINGS[label]),
            )
            if scans:
                yield Figure(what=f"{what}: published a second", unit="", samples=tuple(scans))


@contextmanager
def _count_scans(endpoint: str, rates: list[float]) -> Iterator[None]:
    """Append how many scans of the lidar come in a second; the page cannot draw more."""
    with (
        connected(endpoint) as bus,
        closing(bus.subscribe(SCAN.key(LIDAR_BOT), depth=MOST_SCANS)) as scans,
    ):
        began = time.perf_counter()
        yield
        rates.append(len(scans.take()) / (time.perf_counter() - began))


def _order_lidar() -> Iterator[SpawnEntity]:
    """Order a robot with a lidar, and a room around it."""
    pose = PoseStamped(pose=Pose(Point(*LIDAR_AT, 0.0)))
    robot = Resource(resource_string=read_builtin_model("box_bot_lidar"))
    yield SpawnEntity(
        name=LIDAR_BOT, entity_namespace=LIDAR_BOT, entity_resource=robot, initial_pose=pose
    )
    half = ROOM_M / 2.0
    walls = [
        WALL.format(name=f"{axis}{side:+.0f}", **size, x=side * half * x, y=side * half * (1 - x))
        for axis, x, size in (
            ("x", 1, {"length": 0.1, "width": ROOM_M}),
            ("y", 0, {"length": ROOM_M, "width": 0.1}),
        )
        for side in (-1, 1)
    ]
    room = (
        '<sdf version="1.9"><model name="room"><static>true</static><link name="link">'
        f"{''.join(walls)}</link></model></sdf>"
    )
    yield SpawnEntity(
        name="room", entity_resource=Resource(resource_string=room), initial_pose=pose
    )


def _measure_search(page: Page) -> Iterator[Figure]:
    """Search robots by name; measure until the camera moves."""
    delays = []
    with PageUser(page.url) as user:
        _wait_for(lambda: _find_row(user, "box_bot0"), "a list")
        for number in range(min(SEARCHES, page.robots)):
            delays.append(_time_search(user, f"box_bot{page.robots - 1 - number}"))
            _stop_following(user)
    yield Figure(
        what=f"{page.robots} robots drive: name given, row pressed, camera moves",
        unit="ms",
        samples=tuple(delays),
        limit=_limit("max", "<=", MOST_SEARCH_MS),
    )


def _time_search(user: PageUser, name: str) -> float:
    """Search an entity and select it; return the time [ms] until the camera moves."""
    began, before = time.perf_counter(), user.camera_messages
    user.give("Search", name)
    user.press(_wait_for(lambda: _find_only_row(user, name), f"the row of {name}"))
    _wait_for(lambda: user.camera_messages > before, f"a camera that moves to {name}")
    return 1e3 * (time.perf_counter() - began)


def _find_row(user: PageUser, name: str) -> str:
    """Find the label of the row of an entity; empty if there is none."""
    return next((one for one in user.list_labels() if one.startswith(f"{name} · ")), "")


def _find_only_row(user: PageUser, name: str) -> str:
    """Find the row of an entity once the list has no other: its rows have moved then."""
    return _find_row(user, name) if ">1 of " in user.texts() else ""


def _stop_following(user: PageUser) -> None:
    user.press("Stop following")
    eventually(lambda: "Stop following" not in user.list_labels(), 10.0, "no selection")


def _wait_for(find: Callable[[], Found], what: str) -> Found:
    """Wait until something is found, without the delay of polling rarely.

    Raises:
        TimeoutError: It was not within `PATIENCE_S`.
    """
    ends_at = time.perf_counter() + PATIENCE_S
    while not (found := find()):
        if time.perf_counter() >= ends_at:
            raise TimeoutError(f"no {what} within {PATIENCE_S:g} s")
        time.sleep(POLL_S)
    return found


def _make_cores(what: str, cores: tuple[float, ...], most: float) -> Figure:
    limit = _limit("median", "<=", most)
    return Figure(what=f"{what}: CPU of the page", unit="cores", samples=cores, limit=limit)


def _make_bytes(what: str, visits: Visits, most: float) -> Figure:
    return Figure(
        what=f"{what}: sent a second",
        unit="kB",
        samples=tuple(second.bytes * KILOBYTES for second in visits.seconds),
        limit=_limit("median", "<=", most),
    )


def _limit(statistic: Statistic, relation: str, bound: float) -> Limit:
    return Limit(statistic, relation, bound, is_timed=True)  # type: ignore[arg-type]
