"""Control from the 3D page

Delays from what a visitor does to its effect: commands as a subscriber of `cmd_vel` receives them,
states and names as the page shows them. Visitors are programs that send what the page's script and
controls send; the rows of Chromium press real keys in a headless browser that renders in software,
in a small window, as a key waits for the frame that is being drawn. How long it waits is the delay
until the script of the page sends; the rows without a scene draw 4 x 4 pixels of it. `silent` is a
page whose messages end while its connection stays.
"""

import signal
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import partial

from benchmarks.figures import Figure, Limit, Statistic, table
from tests.integration.chromium import Tab, open_page
from tests.integration.docs_media import HAS_ROBOTS, IS_STILL
from tests.integration.page_user import PageUser
from tests.integration.processes import Server, eventually, free_endpoint, running, serving
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.messages.telemetry_messages import Info
from zensim.proto.network_protocols import Subscription
from zensim.proto.topic_catalog import CMD_VEL
from zensim.spawner.page.side_panel import format_clock

__all__ = ["rows", "table"]

PRESSES, PRESSES_WHEN_SHORT = 20, 1
HELD_S = 0.3
REPEAT_S = 0.05
POLL_S = 0.001
CLOSE_S = 1e-3
"""Less than a step of 4 ms: a step before the last is shown as another time, and passes at once."""
MOST_MS = {"key": 100.0, "stop": 300.0, "spawn": 1000.0, "state": 300.0}
MOST_GREY_S, MOST_LIVE_S = 2.0, 3.0
ROBOT = "r1"
AHEAD = {"forward": 1.0, "left": 0.0, "turn": 0.0}
STOP = dict.fromkeys(AHEAD, 0.0)
Claim = Callable[[Info], bool]
SMALL_WINDOW = (700, 440)
NO_SCENE = """
window.__viserMutable.canvas.parentElement.parentElement.style.cssText =
  "position: fixed; width: 4px; height: 4px"
"""
NOTE_SENDING = """
(() => {
  const page = window.__viserMutable, send = page.sendMessage;
  window.zensimSent = [];
  page.sendMessage = (message) => {
    const now = performance.timeOrigin + performance.now();
    if (message.type === "ZensimDrive" && message.forward) window.zensimSent.push(now);
    send(message);
  };
})()
"""
"""Notes when the script of the page sends that a key is held [ms]."""
KEY = {"code": "KeyW", "key": "w", "windowsVirtualKeyCode": 87}


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure keys, ends of driving, spawns, the control of time, and a lost server."""
    count = PRESSES_WHEN_SHORT if is_short else PRESSES
    with serving() as server:
        spawned = server.zensim("spawn", "box_bot", "--name", ROBOT)
        assert spawned.returncode == 0, spawned.stderr
        with _viewing(server) as url:
            yield from _measure_driving(server, url, count)
            yield from _measure_browser(server, url, count)
            yield from _measure_edits(server, url, count)
    yield from _measure_loss(1 if is_short else 5)


@contextmanager
def _viewing(server: Server) -> Iterator[str]:
    with running("view", "--connect", server.endpoint, "--port", "0") as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]


def _measure_driving(server: Server, url: str, count: int) -> Iterator[Figure]:
    ends: dict[str, Callable[[PageUser], None]] = {
        "released": lambda user: user.send("ZensimDrive", **STOP),
        "hidden page": lambda user: user.send("ZensimLeave"),
        "closed page": lambda user: user.close(),
        "silent page": lambda _: None,
    }
    with closing(server.bus.subscribe(CMD_VEL.key(ROBOT), depth=1000)) as commands:
        keys: list[float] = []
        for what, end in ends.items():
            stops = []
            for _ in range(count):
                with PageUser(url) as user:
                    _select(user)
                    keys.append(_drive(user, commands))
                    end(user)
                    stops.append(_time_until(lambda: _is_stopped(commands)))
            yield _make_delay(f"{what} to a command of zero", stops, "max", "stop")
        yield _make_delay("key message to a command", keys, "p95", "key")


def _drive(user: PageUser, commands: Subscription) -> float:
    """Hold a key for a moment; return the delay [s] of the first command."""
    commands.take()
    user.send("ZensimDrive", **AHEAD)
    delay = _time_until(lambda: any(one.linear.x > 0.0 for one in _read(commands)))
    ends_at = time.perf_counter() + HELD_S
    while time.perf_counter() < ends_at:
        user.send("ZensimDrive", **AHEAD)
        time.sleep(REPEAT_S)
    commands.take()
    return delay


def _measure_browser(server: Server, url: str, count: int) -> Iterator[Figure]:
    with open_page(url) as tab:
        tab.set_size(*SMALL_WINDOW)
        tab.until("!!window.zensimDrives && !!window.__viserMutable.sendMessage", 120.0)
        tab.until(HAS_ROBOTS, 120.0)
        tab.until(IS_STILL, 120.0)
        tab.evaluate(NOTE_SENDING)
        yield from _measure_keys(server, tab, count, "Chromium")
        tab.evaluate(NO_SCENE)
        yield from _measure_keys(server, tab, count, "Chromium without a scene")


def _measure_keys(server: Server, tab: Tab, count: int, what: str) -> Iterator[Figure]:
    select = f'window.__viserMutable.sendMessage({{type: "ZensimSelect", entity: "{ROBOT}"}})'
    with closing(server.bus.subscribe(CMD_VEL.key(ROBOT), depth=1000)) as commands:

        def is_driven() -> bool:
            tab.evaluate(select)
            _press(tab, "rawKeyDown")
            _press(tab, "keyUp")
            return any(one.linear.x > 0.0 for one in _read(commands))

        eventually(is_driven, 60.0, "driving by a key")
        downs, ups = list[float](), list[float]()
        sent = list[float | None]()
        for _ in range(count):
            _time_until(lambda: _is_stopped(commands), 1.0)
            commands.take()
            tab.evaluate("window.zensimSent = [], 0")
            began_ms = 1e3 * time.time()
            downs.append(_time_press(tab, "rawKeyDown", lambda: bool(_read(commands))))
            sent_ms = tab.evaluate("window.zensimSent[0]")
            sent.append(None if sent_ms is None else (sent_ms - began_ms) / 1e3)
            ups.append(_time_press(tab, "keyUp", lambda: _is_stopped(commands)))
    yield _make_delay(f"{what}: key down to a command", downs, "p95", "key")
    yield from make_sent_figures(what, sent)
    yield _make_delay(f"{what}: key up to a command of zero", ups, "max", "stop")


def _press(tab: Tab, kind: str) -> None:
    tab.call("Input.dispatchKeyEvent", type=kind, **KEY)


def _time_press(tab: Tab, kind: str, is_done: Callable[[], bool]) -> float:
    began = time.perf_counter()
    _press(tab, kind)
    _time_until(is_done)
    return time.perf_counter() - began


def _measure_edits(server: Server, url: str, count: int) -> Iterator[Figure]:
    with PageUser(url) as user:
        eventually(lambda: "box_bot" in user.options_of("Model"), 30.0, "models")
        spawns = []
        for number in range(count):
            user.give("Name", f"made{number}")
            user.give("Place x, y [m]", (2.0 * number, 5.0))
            user.press("Spawn")
            spawns.append(_time_until(partial(_is_drawn, url, f"made{number}")))
        yield _make_delay("spawn form to the robot drawn", spawns, "max", "spawn")
        yield from _measure_time(server, user, count)


def _measure_time(server: Server, user: PageUser, count: int) -> Iterator[Figure]:
    delays: dict[str, list[float]] = {}

    def change(control: str, value: object, is_at: Claim, text: str = "") -> None:
        user.give(control, value)

        def find() -> Info | None:
            info = server.client.info()
            return info if is_at(info) else None

        info = eventually(find, 10.0, control)
        shown = text or format_clock(info.sim_time_s)
        what = f"{control}, {value}" if isinstance(value, str | float) else control
        delays.setdefault(what, []).append(_time_until(lambda: shown in user.texts()))

    for _ in range(count):
        change("Simulation", "Pause", lambda info: info.state == "paused", "paused")
        before = server.client.info()
        change("Step", "10 steps", partial(_has_step, before.steps + 10))
        goal = round(server.client.info().sim_time_s + 0.3, 1)
        user.give("Time [s]", goal)
        change("Run to this time", True, partial(_has_time, goal))  # noqa: FBT003  a button
        change("Reset", True, partial(_is_after_epoch, before.epoch))  # noqa: FBT003
        change("Simulation", "Play", lambda info: info.state == "playing", "playing")
        for factor in (0.5, 2.0, 1.0):
            change("Speed", factor, partial(_has_factor, factor), f"of {factor:.2f} wanted")
    for what, samples in delays.items():
        yield _make_delay(f"{what}: the bus to the page", samples, "max", "state")


def _has_step(step: int, info: Info) -> bool:
    return info.steps == step


def _has_time(goal_s: float, info: Info) -> bool:
    return abs(info.sim_time_s - goal_s) < CLOSE_S


def _is_after_epoch(epoch: int, info: Info) -> bool:
    return info.epoch > epoch


def _has_factor(factor: float, info: Info) -> bool:
    return info.target_real_time_factor == factor


def _measure_loss(count: int) -> Iterator[Figure]:
    """Kill a server and start it again, several times, beside one page."""
    greys: list[float] = []
    lives: list[float] = []
    endpoint = free_endpoint()
    with serving(endpoint=endpoint) as first, ExitStack() as stack:
        process = stack.enter_context(running("view", "--connect", endpoint, "--port", "0"))
        assert process.stdout is not None
        user = stack.enter_context(PageUser(process.stdout.readline().split()[-1]))
        eventually(lambda: "playing" in user.texts(), 30.0, "a live page")
        greys.append(_kill(first, user))
        for _ in range(count):
            with serving(endpoint=endpoint) as server:
                lives.append(_time_until(lambda: "playing" in user.texts(), 60.0))
                greys.append(_kill(server, user))
    yield _make_span("server killed to a grey scene", greys, MOST_GREY_S)
    yield _make_span("server answers again to a live scene", lives, MOST_LIVE_S)


def _kill(server: Server, user: PageUser) -> float:
    """Kill a server; return the time [s] until the scene is grey."""
    user.scripts.clear()
    server.process.send_signal(signal.SIGKILL)
    return _time_until(lambda: "zensimGreys(true)" in user.scripts, 60.0)


def _make_span(what: str, spans: list[float], most_s: float) -> Figure:
    limit = Limit("max", "<=", most_s, is_timed=True)
    return Figure(what=what, unit="s", samples=tuple(spans), limit=limit)


def _is_drawn(url: str, name: str) -> bool:
    with urllib.request.urlopen(f"{url}/names") as response:
        return f'"{name}"' in response.read().decode()


def _select(user: PageUser) -> None:
    user.wait_for_row(ROBOT)
    user.send("ZensimSelect", entity=ROBOT)
    eventually(lambda: f"{ROBOT}: driven by" in user.texts(), 30.0, "selecting the robot")


def _read(commands: Subscription) -> list[Twist]:
    return [decode_twist(one.payload, one.encoding) for one in commands.take()]


def _is_stopped(commands: Subscription) -> bool:
    return Twist() in _read(commands)


def _time_until(is_done: Callable[[], bool], within_s: float = 10.0) -> float:
    """Wait until something is so; return the time [s], at most the limit."""
    began = time.perf_counter()
    while not is_done() and time.perf_counter() < began + within_s:
        time.sleep(POLL_S)
    return time.perf_counter() - began


def make_sent_figures(what: str, delays: Sequence[float | None]) -> Iterator[Figure]:
    """Make figures of the delays [s] of the page's script; None = it sent nothing."""
    sent_ms = tuple(1e3 * delay for delay in delays if delay is not None)
    limit = Limit("max", "<=", 0.0)
    missing = (float(len(delays) - len(sent_ms)),)
    label = f"{what}: keys down after which the script of the page sends nothing"
    yield Figure(what=label, unit="", samples=missing, limit=limit)
    if sent_ms:
        label = f"{what}: key down until the script of the page sends"
        yield Figure(what=label, unit="ms", samples=sent_ms)


def _make_delay(what: str, delays: list[float], statistic: Statistic, kind: str) -> Figure:
    return Figure(
        what=what,
        unit="ms",
        samples=tuple(1e3 * delay for delay in delays),
        limit=Limit(statistic, "<=", MOST_MS[kind], is_timed=True),
    )
