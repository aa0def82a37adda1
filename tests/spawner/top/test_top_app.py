"""The screen of `zensim top`, by keys, with readings from memory."""

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from itertools import count

from rich.text import Text  # noqa: TC002  in signatures of tests
from textual.pilot import Pilot  # noqa: TC002  in signatures of tests
from textual.widgets import DataTable  # noqa: TC002

from tests.spawner.top.readings import a_reading
from zensim.spawner.top.fleet_figures import FleetReading
from zensim.spawner.top.top_app import TopApp


class MemorySource:
    """Readings of successive seconds."""

    def __init__(self) -> None:
        self._seconds = count(10)
        self.watched: list[str] = []

    def watch(self, namespaces: Iterable[str]) -> None:
        self.watched = list(namespaces)

    def read(self) -> FleetReading:
        return a_reading(next(self._seconds))


def run(
    act: Callable[[TopApp, "Pilot[None]"], Awaitable[None]], *, max_rates: int = 10
) -> MemorySource:
    """Run the screen until it shows shares, then act."""
    source = MemorySource()

    async def run_screen() -> None:
        app = TopApp(source, period_s=0.1, max_rates=max_rates)
        async with app.run_test(size=(120, 30)) as pilot:
            while "50.0 %" not in read_cells(app.processes):
                await pilot.pause(0.01)
            await act(app, pilot)

    asyncio.run(run_screen())
    return source


def read_cells(table: "DataTable[Text]") -> list[str]:
    return [str(cell) for row in range(table.row_count) for cell in table.get_row_at(row)]


def read_names(app: TopApp) -> list[str]:
    return [row.name for row in app.robots.shown]


def test_screen_shows_summary_processes_and_robots() -> None:
    async def act(app: TopApp, _: "Pilot[None]") -> None:
        assert "0.98 of 1" in str(app.summary.render())
        assert {"pool", "100.0", "64.0"} <= set(read_cells(app.processes))
        assert {"r1", "team/r2", "omni[/]bot", "5.00"} <= set(read_cells(app.robots))

    run(act)


def test_keys_sort_and_reverse_the_robots() -> None:
    orders = []

    async def act(app: TopApp, pilot: "Pilot[None]") -> None:
        await pilot.press("r")
        orders.append(read_names(app))
        await pilot.press("s", "s", "s", "s")
        orders.append([app.robots.sorted_by, *read_names(app)])

    run(act)

    assert orders == [["team/r2", "r1"], ["x", "r1", "team/r2"]]


def test_filter_is_typed_and_cleared() -> None:
    found = []

    async def act(app: TopApp, pilot: "Pilot[None]") -> None:
        await pilot.press("slash", "t", "e", "a", "enter")
        found.append(read_names(app))
        await pilot.press("escape")
        found.append(read_names(app))

    run(act)

    assert found == [["team/r2"], ["r1", "team/r2"]]


def test_tab_and_sort_act_on_the_processes() -> None:
    async def act(app: TopApp, pilot: "Pilot[None]") -> None:
        app.processes.focus()
        await pilot.press("r")
        assert app.processes.is_descending
        assert not app.robots.is_descending

    run(act)


def test_only_visible_robots_are_measured_up_to_the_limit() -> None:
    async def act(_: TopApp, pilot: "Pilot[None]") -> None:
        await pilot.press("question_mark")

    assert run(act).watched == ["r1", "team/r2"]
    assert run(act, max_rates=1).watched == ["r1"]
