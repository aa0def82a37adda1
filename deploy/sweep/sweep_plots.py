"""Draws margins of the runs of a sweep over the numbers that varied."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from zensim.deploy.sweep.sweep_rows import SweepRow
from zensim.proto.printable_text import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_INPUTS, MAX_MARGINS = 4, 8
"""Columns and rows of panels."""
PANEL_WIDTH_IN, PANEL_HEIGHT_IN = 4.0, 2.6
SEED_NUMBER: Final = "number of the seed"


def draw_margins(rows: Sequence[SweepRow], path: Path, *, title: str) -> int:
    """Draw a panel for each pair of a check and a number that varied; each point is a run.

    Args:
        rows: At least one with a margin.
        path: File, whose suffix gives the format: `.png`, `.svg` or `.pdf`.
        title: Of the picture.

    Returns:
        Number of panels.

    Raises:
        OSError: The file cannot be written.
    """
    # In an extra, and it takes 0.5 s to load.
    import matplotlib as mpl  # noqa: PLC0415
    from matplotlib import style  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    from zensim.recording.series_chart import DPI, STYLE  # noqa: PLC0415

    inputs = _find_numbers(rows)[:MAX_INPUTS] or [SEED_NUMBER]
    names = list(dict.fromkeys(name for row in rows for name in row.margins))[:MAX_MARGINS]
    settings: dict[Any, Any] = {"svg.hashsalt": "zensim", "text.parse_math": False}
    with mpl.rc_context(settings), style.context(STYLE):
        size = (2.0 + PANEL_WIDTH_IN * len(inputs), 0.8 + PANEL_HEIGHT_IN * len(names))
        figure = Figure(figsize=size, layout="constrained")
        figure.suptitle(printable(title))
        panels = figure.subplots(len(names), len(inputs), sharex="col", squeeze=False)
        for row_number, name in enumerate(names):
            for column, key in enumerate(inputs):
                _draw_panel(panels[row_number, column], rows, key, name)
            panels[row_number, 0].set_ylabel(printable(f"margin of {name}"))
        for column, key in enumerate(inputs):
            panels[-1, column].set_xlabel(printable(key))
        metadata = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(path, dpi=DPI, metadata=metadata)
    return len(names) * len(inputs)


def _find_numbers(rows: Sequence[SweepRow]) -> list[str]:
    """Find the inputs that are numbers and have at least two values."""
    paths = dict.fromkeys(path for row in rows for path in row.inputs)
    return [path for path in paths if len({_read_input(row, path) for row in rows} - {None}) > 1]


def _read_input(row: SweepRow, path: str) -> float | None:
    value = row.number if path == SEED_NUMBER else row.inputs.get(path)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number else None  # type: ignore[arg-type]  # it is a number


def _draw_panel(panel: "Axes", rows: Sequence[SweepRow], path: str, name: str) -> None:
    points = [(_read_input(row, path), row.margins.get(name), name in row.failed) for row in rows]
    known = [(x, y, is_bad) for x, y, is_bad in points if x is not None and y is not None]
    for is_bad, marker, label in ((False, "o", "passed"), (True, "x", "failed")):
        own = np.array([(x, y) for x, y, bad in known if bad is is_bad]).reshape(-1, 2)
        panel.scatter(own[:, 0], own[:, 1], s=18, marker=marker, label=label)
    values = sorted({x for x, _, _ in known})
    means = [np.mean([y for x, y, _ in known if x == value]) for value in values]
    if len(values) < len(known):
        panel.plot(values, means, linewidth=1.0, color="0.4", label="mean")
    panel.axhline(0.0, color="0.2", linewidth=0.8)
    panel.grid(visible=True, alpha=0.3)
    if known:
        panel.legend(fontsize="x-small")
