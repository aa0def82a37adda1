"""The screen of `zensim top`: two tables that are sorted and filtered by keys."""

from collections.abc import Iterable, Sequence
from typing import ClassVar, Final, Generic, Protocol

from rich.text import Text
from textual import work
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.coordinate import Coordinate
from textual.widgets import DataTable, Footer, Input, Static
from textual.worker import get_current_worker

from zensim.proto.printable_text import printable
from zensim.spawner.top.fleet_figures import (
    PROCESS_TITLES,
    ROBOT_TITLES,
    FleetReading,
    ProcessRow,
    RobotRow,
    Row,
    filter_rows,
    format_value,
    list_process_rows,
    list_robot_rows,
    sort_rows,
    write_summary,
)

NUMBERS: Final = frozenset(
    {"process_id", "cpu", "memory_mib", "robots", "rate_hz", "due_hz", "x", "y", "speed", "odom_hz"}
)
ARROWS: Final = {False: " ▲", True: " ▼"}
HELP_TEXT: Final = (
    "tab: other table   s: sort by the next column   r: reverse   /: filter, escape: no filter   "
    "click on a title: sort   q: end"
)


class ReadingSource(Protocol):
    """Where readings come from: `FleetSource`."""

    def watch(self, namespaces: Iterable[str]) -> None:
        """Measure the rates of odometry of these robots only."""

    def read(self) -> FleetReading:
        """Read what was reported."""


class FigureTable(DataTable[Text], Generic[Row]):
    """A table of rows with names, which keeps its order and cursor while values change."""

    def __init__(self, titles: dict[str, str], *, table_id: str) -> None:
        super().__init__(id=table_id, cursor_type="row", zebra_stripes=True)
        self.titles = titles
        self.sorted_by = "name"
        self.is_descending = False
        self.filter_text = ""
        self.shown: list[Row] = []
        self.rows_given: Sequence[Row] = ()

    def on_mount(self) -> None:
        """Add the columns."""
        for column in self.titles:
            self.add_column(self._write_title(column), key=column)

    def sort_by(self, column: str) -> None:
        """Sort by a column; the same one again is reversed. Numbers begin with the greatest."""
        if column == self.sorted_by:
            self.is_descending = not self.is_descending
        else:
            self.sorted_by, self.is_descending = column, column in NUMBERS
        self.show(self.rows_given)

    def sort_by_next(self) -> None:
        """Sort by the column after the present one."""
        names = list(self.titles)
        self.sort_by(names[(names.index(self.sorted_by) + 1) % len(names)])

    def show(self, rows: Sequence[Row]) -> None:
        """Show rows, in the order and of the filter that were chosen."""
        self.rows_given = rows
        chosen = filter_rows(rows, self.filter_text)
        ordered = sort_rows(chosen, self.sorted_by, is_descending=self.is_descending)
        for column in self.titles:
            self.columns[column].label = self._write_title(column)  # type: ignore[index]
        if len(ordered) == self.row_count:
            self._update_cells(ordered)
        else:
            self._fill(ordered)
        self.shown = ordered

    def list_visible(self) -> list[Row]:
        """List the rows that are on the screen."""
        first = max(0, int(self.scroll_offset.y))
        return self.shown[first : first + max(0, self.size.height)]

    def _update_cells(self, ordered: Sequence[Row]) -> None:
        for place, (row, before) in enumerate(zip(ordered, self.shown, strict=True)):
            for number, column in enumerate(self.titles):
                value = getattr(row, column)
                if value != getattr(before, column):
                    self.update_cell_at(Coordinate(place, number), _write_cell(column, value))

    def _fill(self, ordered: Sequence[Row]) -> None:
        cursor = self.cursor_coordinate
        self.clear()
        for row in ordered:
            self.add_row(*(_write_cell(column, getattr(row, column)) for column in self.titles))
        self.move_cursor(row=min(cursor.row, max(0, len(ordered) - 1)))

    def _write_title(self, column: str) -> Text:
        arrow = ARROWS[self.is_descending] if column == self.sorted_by else ""
        return Text(self.titles[column] + arrow)


def _write_cell(column: str, value: object) -> Text:
    # As Text: names must not be parsed as markup.
    justify = "right" if column in NUMBERS else "left"
    return Text(printable(format_value(column, value)), justify=justify)  # type: ignore[arg-type]


class TopApp(App[None]):
    """Summary, processes, robots."""

    CSS = """
    #summary { height: auto; padding: 0 1; }
    #processes { height: auto; max-height: 40%; }
    #robots { height: 1fr; }
    #filter { display: none; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "quit", "End"),
        Binding("s", "sort", "Sort by next"),
        Binding("r", "reverse", "Reverse"),
        Binding("slash", "filter", "Filter", key_display="/"),
        Binding("escape", "clear_filter", "No filter", priority=True),
        Binding("question_mark", "help_keys", "Help", key_display="?"),
    ]
    ENABLE_COMMAND_PALETTE = False

    def __init__(
        self, source: ReadingSource, *, period_s: float, max_rates: int, filter_text: str = ""
    ) -> None:
        """Take the source.

        Args:
            source: Of the readings; it is used by one thread at a time.
            period_s: Between readings.
            max_rates: Greatest number of robots whose rates of odometry are measured.
            filter_text: Of the robots, at the start.
        """
        super().__init__()
        self._source = source
        self._period_s = period_s
        self._max_rates = max_rates
        self._before: FleetReading | None = None
        self.processes = FigureTable[ProcessRow](PROCESS_TITLES, table_id="processes")
        self.robots = FigureTable[RobotRow](ROBOT_TITLES, table_id="robots")
        self.robots.filter_text = filter_text
        self.summary = Static("waiting for reports", id="summary", markup=False)
        self._field = Input(placeholder="part of a name, model, drive or agent", id="filter")

    def compose(self) -> ComposeResult:
        """Arrange the screen."""
        yield self.summary
        yield self.processes
        yield self.robots
        yield self._field
        yield Footer()

    def on_mount(self) -> None:
        """Begin to read."""
        self.robots.focus()
        self._read_forever()

    @work(thread=True, exclusive=True)
    def _read_forever(self) -> None:
        """Read in a thread, so that keys are handled while a server is silent."""
        worker = get_current_worker()
        while not worker.is_cancelled:
            reading = self._source.read()
            if self.is_running and not worker.is_cancelled:
                self.call_from_thread(self._show, reading)
            worker.cancelled_event.wait(self._period_s)

    def _show(self, reading: FleetReading) -> None:
        self.summary.update(write_summary(reading))
        self.processes.show(list_process_rows(reading, self._before))
        self.robots.show(list_robot_rows(reading))
        self._before = reading
        visible = self.robots.list_visible()[: self._max_rates]
        self._source.watch([row.name for row in visible])

    @property
    def _table(self) -> "FigureTable[ProcessRow] | FigureTable[RobotRow]":
        return self.processes if self.focused is self.processes else self.robots

    def on_data_table_header_selected(self, event: DataTable.HeaderSelected) -> None:
        """Sort by the column whose title was clicked."""
        table = self.processes if event.data_table is self.processes else self.robots
        table.sort_by(str(event.column_key.value))

    def action_sort(self) -> None:
        """Sort the focused table by its next column."""
        self._table.sort_by_next()

    def action_reverse(self) -> None:
        """Reverse the order of the focused table."""
        self._table.sort_by(self._table.sorted_by)

    def action_filter(self) -> None:
        """Type a filter of the robots."""
        self._field.styles.display = "block"
        self._field.focus()

    def action_clear_filter(self) -> None:
        """Show all robots."""
        self._field.value = ""
        self._filter("")
        self._field.styles.display = "none"
        self.robots.focus()

    def action_help_keys(self) -> None:
        """Say what the keys do."""
        self.notify(HELP_TEXT, title="Keys", timeout=10.0)

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter while typing."""
        self._filter(event.value)

    def on_input_submitted(self, _: Input.Submitted) -> None:
        """Go back to the robots, with the filter."""
        self.robots.focus()

    def _filter(self, text: str) -> None:
        self.robots.filter_text = text
        self.robots.show(self.robots.rows_given)
