"""The tab "Plots": speed, position and sensors of the selected robots over time."""

import time
from collections.abc import Callable, Sequence
from typing import Final

import msgspec
import numpy as np
import viser
from viser import uplot

from zensim.proto.messages.model_messages import Model
from zensim.proto.printable_text import to_html
from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.page_theme import MUTED_BUTTON
from zensim.spawner.page.plot_history import (
    FACTOR,
    PlotHistory,
    find_axis_range,
    format_number,
    measure_robot,
    name_robot_columns,
    read_numbers,
)
from zensim.spawner.page.robot_colours import ROBOT_COLOURS, Rgb, find_robot_colour
from zensim.spawner.page.side_panel import WatchedTopic
from zensim.spawner.page.viewer_client import PageState, Panel, ViewerClient

PLOT_PERIOD_S: Final = 0.2
MAX_PLOTTED: Final = 4
"""Robots in a chart."""
CHARTS: Final = ("Speed", "Turn rate", "Position", "Real-time factor")
NO_SENSOR: Final = "none"
PLOTTED_TOPICS: Final = frozenset(
    {"imu", "scan", "range", "joint_states", "vel", "altimeter", "magnetic_field", "air_pressure"}
)
FREE_CHARTS: Final = ("Position", "Sensor")
"""Charts that need not have zero in view."""
CHART_HEIGHT_PX: Final = 150
TICK_PX: Final = 20
"""Least distance of ticks of the values."""
LEGEND_SHARE: Final = 1e-3
"""Share of the range of a chart below which a value is shown as zero."""
AXIS_COLOUR: Final = "#8b929c"
"""Visible on light and dark ground."""
FILE_NAME: Final = "zensim_plot.csv"


class PlotPanel(Panel):
    """Controls of the tab."""

    def __init__(self, client: ViewerClient) -> None:
        """Add the controls for a visitor."""
        self._client, self._next_at = client, 0.0
        self._history, self._sensed = PlotHistory(), PlotHistory()
        gui = client.gui
        self._note = gui.add_html(make_note_html(()))
        self._boxes = {
            title: gui.add_checkbox(title, title == "Speed", hint=f"Plot it: {title.lower()}.")
            for title in CHARTS
        }
        self._sensor = gui.add_dropdown(
            "Sensor", (NO_SENSOR,), hint="Topic of the first selected robot."
        )
        self._sensor.on_update(client.defer(lambda _: self._watch()))
        self._topics: dict[str, WatchedTopic] = {}
        save = gui.add_button("Save as CSV", color=MUTED_BUTTON, hint="Download what is plotted.")
        save.on_click(client.defer(lambda _: self._save()))
        self._charts = {title: Chart(client.gui, title) for title in (*CHARTS, "Sensor")}

    def draw(self, state: PageState) -> None:
        """Add the newest values, 5 times a second."""
        if time.monotonic() < self._next_at:
            return
        self._next_at = time.monotonic() + PLOT_PERIOD_S
        if not self._is_plotting() and self._sensor.value == NO_SENSOR:
            self._show()
            return
        values = {FACTOR: state.status.real_time_factor}
        for name in self._list_plotted():
            values |= measure_robot(name, state.state_of(name), state.commands.get(name))
        if self._history.add(state.status.sim_time_s, values):
            self._show()

    def show_message(self, watch: WatchedTopic, message: msgspec.Struct) -> None:
        """Add the numbers of a message of the chosen topic."""
        if watch == self._topics.get(self._sensor.value):
            self._sensed.add(self._client.state.status.sim_time_s, read_numbers(message))

    def change_selection(self) -> None:
        """Offer the topics of the first selected robot."""
        fleet, selected = self._client.state.fleet, self._client.selected
        self._topics = {}
        if selected and fleet.members[selected[0]].namespace:
            watches = list_plotted_topics(selected[0], fleet.model_of(selected[0]))
            self._topics = {watch.name: watch for watch in watches}
        self._sensor.options = (NO_SENSOR, *self._topics)
        self._note.content = make_note_html(self._list_plotted())
        self._watch()

    def _is_plotting(self) -> bool:
        is_on = [title for title, box in self._boxes.items() if box.value]
        return "Real-time factor" in is_on or bool(is_on and self._client.selected)

    def _watch(self) -> None:
        watch = self._topics.get(self._sensor.value)
        self._client.watch("plots", *([watch] if watch is not None else []))
        self._sensed = PlotHistory()
        self._show()

    def _list_plotted(self) -> Sequence[str]:
        return self._client.selected[:MAX_PLOTTED]

    def _show(self) -> None:
        robots = self._list_plotted()
        for title, chart in self._charts.items():
            if title == "Sensor":
                chart.show(self._sensed, list(self._sensed.columns), color_fields)
            elif not self._boxes[title].value:
                chart.hide()
            else:
                columns = [FACTOR] if title == "Real-time factor" else []
                if not columns:
                    columns = [c for name in robots for c in name_robot_columns(name)[title]]
                known = [column for column in columns if column in self._history.columns]
                chart.show(self._history, known, color_robots)

    def _save(self) -> None:
        history = self._history if self._history.columns else self._sensed
        if not history.columns:
            self._client.warn("nothing is plotted; switch on Speed, or select a robot and a sensor")
            return
        self._client.client.send_file_download(FILE_NAME, history.make_csv(), save_immediately=True)


def make_note_html(plotted: Sequence[str]) -> str:
    """Say which robots are plotted, and how others are."""
    how = f"shift and click adds others, up to {MAX_PLOTTED}."
    text = f"Plotted: {', '.join(plotted)}; {how}" if plotted else f"Select a robot; {how}"
    return f'<div style="padding:.15em .7em;font-size:.85em">{to_html(text)}</div>'


Pen = tuple[Rgb, bool]
"""Colour of a line, and whether it is dashed."""


def color_robots(columns: Sequence[str]) -> list[Pen]:
    """Choose the pens of the columns of robots: that of the robot, the second one dashed."""
    return [(find_robot_colour(c.split(" ")[0]), bool(i % 2)) for i, c in enumerate(columns)]


def color_fields(columns: Sequence[str]) -> list[Pen]:
    """Choose the pens of the fields of a message."""
    return [(ROBOT_COLOURS[i % len(ROBOT_COLOURS)], False) for i in range(len(columns))]


def make_legend_html(columns: Sequence[str], pens: Sequence[Pen], newest: Sequence[Array]) -> str:
    """Say what the lines of a chart are, and their newest value (1,) if there is one."""
    rows = []
    for column, ((red, green, blue), is_dashed), values in zip(columns, pens, newest, strict=True):
        style = f"{'dashed' if is_dashed else 'solid'} rgb({red},{green},{blue})"
        value = format_number(float(values[0])) if len(values) else ""
        rows.append(
            f'<dt><i style="border-top:2px {style}"></i>{to_html(column)}</dt><dd>{value}</dd>'
        )
    return f'<dl class="zensim-legend">{"".join(rows)}</dl>'


def list_plotted_topics(entity: str, model: Model) -> list[WatchedTopic]:
    """List the topics of the sensors of an entity that can be plotted."""
    return [
        WatchedTopic(topic.topic, entity, topic.name)
        for sensor in model.sensors
        for topic in sensor.topics
        if topic.topic in PLOTTED_TOPICS
    ]


class Chart:
    """A chart that exists while it has columns to show."""

    def __init__(self, gui: viser.GuiApi, title: str) -> None:
        self._gui = gui
        self._place = gui.add_folder(title, visible=False)
        self._plot: viser.GuiUplotHandle | None = None
        self._columns: list[str] = []
        self._legend: viser.GuiHtmlHandle | None = None
        self._range = (0.0, 0.0)
        self._has_zero = title not in FREE_CHARTS

    def show(
        self,
        history: PlotHistory,
        columns: list[str],
        choose_pens: Callable[[Sequence[str]], list[Pen]],
    ) -> None:
        """Show these columns of a history."""
        if not columns:
            self.hide()
            return
        data = history.make_arrays(columns)
        limits = find_axis_range(data[1:], has_zero=self._has_zero)
        pens = choose_pens(columns)
        # What is zero on the scale of the chart is zero in its legend.
        least = LEGEND_SHARE * (limits[1] - limits[0])
        newest = [np.where(np.abs(line[-1:]) < least, 0.0, line[-1:]) for line in data[1:]]
        legend = make_legend_html(columns, pens, newest)
        if self._plot is not None and self._legend is not None and columns == self._columns:
            self._legend.content = legend
            if limits != self._range:
                self._range, self._plot.scales = limits, _make_scales(limits)
            self._plot.data = data
            return
        self.hide()
        self._columns, self._range, self._place.visible = columns, limits, True
        with self._place:
            self._plot = self._gui.add_uplot(
                data,
                (
                    {"label": "simulation time [s]"},
                    *(_describe_line(*one) for one in zip(columns, pens, strict=True)),
                ),
                scales=_make_scales(limits),
                axes=({"stroke": AXIS_COLOUR}, {"stroke": AXIS_COLOUR, "space": TICK_PX}),
                legend={"show": False},
                height=CHART_HEIGHT_PX,
            )
            self._legend = self._gui.add_html(legend)

    def hide(self) -> None:
        """Remove the chart."""
        if self._plot is not None and self._legend is not None:
            self._plot.remove()
            self._legend.remove()
            self._place.visible = False
        self._plot, self._legend, self._columns = None, None, []


def _make_scales(limits: tuple[float, float]) -> dict[str, uplot.Scale]:
    return {"x": {"time": False}, "y": {"range": limits}}


def _describe_line(column: str, pen: Pen) -> uplot.Series:
    (red, green, blue), is_dashed = pen
    line: uplot.Series = {"label": column, "stroke": f"rgb({red},{green},{blue})", "width": 2}
    if is_dashed:
        line["dash"] = (5, 4)
    return line
