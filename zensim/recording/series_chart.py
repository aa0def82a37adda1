"""Draws numbers over time: a panel for each unit, with axes, units and a legend."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
from matplotlib import style
from matplotlib.figure import Figure

from zensim.proto.printable_text import printable
from zensim.recording.message_series import MessageSeries

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WALL_TIME_S: Final = 1e9
"""Log times above it (September 2001) are times of day."""
MAX_LABELS: Final = 24
MAX_LABEL: Final = 80
"""Characters of a label; of a longer one the end is shown, which differs."""
WIDTH_IN, PANEL_HEIGHT_IN, DPI = 10.0, 3.6, 120
STYLE: Final = "tableau-colorblind10"
"""Colours that people with colour blindness distinguish."""


def draw_series(series: Sequence[MessageSeries], path: Path, *, title: str) -> None:
    """Draw series over time into a file whose suffix gives the format: `.png`, `.svg` or `.pdf`.

    Args:
        series: At least one; those of one unit share a panel.
        path: File, which is written over.
        title: Of the chart.

    Raises:
        OSError: The file cannot be written.
    """
    groups: dict[tuple[str, str], list[MessageSeries]] = {}
    for one in series:
        # Without a unit, numbers of different fields are not compared.
        groups.setdefault((one.unit, "" if one.unit else one.field), []).append(one)
    start_s = min((float(one.times_s[0]) for one in series if len(one.times_s)), default=0.0)
    is_wall = start_s > WALL_TIME_S
    # The same numbers give the same file, with texts as texts, and names are no formulas.
    settings: dict[Any, Any] = {
        "svg.hashsalt": "zensim",
        "svg.fonttype": "none",
        "text.parse_math": False,
    }
    with mpl.rc_context(settings), style.context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, PANEL_HEIGHT_IN * len(groups)), layout="constrained")
        figure.suptitle(_shorten(title))
        panels = figure.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
        for panel, members in zip(panels, groups.values(), strict=True):
            _draw_panel(panel, members, start_s if is_wall else 0.0)
        panels[-1].set_xlabel("time since the start [s]" if is_wall else "simulation time [s]")
        # Without the date, for the same file again.
        metadata = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(path, dpi=DPI, metadata=metadata)


def _draw_panel(panel: "Axes", members: Sequence[MessageSeries], origin_s: float) -> None:
    for number, one in enumerate(members):
        label = _write_label(one) if number < MAX_LABELS else None
        panel.plot(one.times_s - origin_s, one.values, linewidth=1.2, label=label)
    fields = list(dict.fromkeys(one.field for one in members))
    unit = members[0].unit
    panel.set_ylabel(_shorten(", ".join(fields[:3])) + (f" [{unit}]" if unit else ""))
    panel.grid(visible=True, alpha=0.3)
    more = len(members) - MAX_LABELS
    title = f"and {more} more" if more > 0 else None
    panel.legend(title=title, loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")


def _write_label(one: MessageSeries) -> str:
    run = f" (run {one.run + 1})" if one.run else ""
    return _shorten(f"{one.topic}:{one.field}{run}")


def _shorten(label: str) -> str:
    text = printable(label)
    return text if len(text) <= MAX_LABEL else f"...{text[-MAX_LABEL:]}"
