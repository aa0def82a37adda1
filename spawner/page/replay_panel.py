"""The tab "Recording": time line and rate of a replay."""

from math import ceil
from typing import Final

from zensim.proto.messages.replay_messages import (
    ReplayReport,
    ReplayRequest,
    ReplaySeekRequest,
    ReplaySetRateRequest,
)
from zensim.proto.replay_catalog import GET_STATE, PAUSE, RESUME, SEEK, SET_RATE
from zensim.spawner.page.side_panel import format_clock
from zensim.spawner.page.viewer_client import PageState, Panel, ViewerClient

RATES: Final = ("0.1", "0.25", "0.5", "1", "2", "5", "10")
"""Recorded time per wall time."""
MOVES: Final = ("Play", "Pause", "-5 s", "+5 s")
SLIDER_STEP_S: Final = 0.1
LEAST_DURATION_S: Final = 0.2
"""A slider needs two positions."""


class ReplayPanel(Panel):
    """Controls of the tab; all visitors see the same replay."""

    def __init__(self, client: ViewerClient) -> None:
        """Add the controls for a visitor."""
        self._client = client
        self._report = ReplayReport()
        self._is_asked = False
        gui = client.gui
        self._text = gui.add_html("")
        self._position = gui.add_slider(
            "Position [s]", min=0.0, max=1.0, step=SLIDER_STEP_S, initial_value=0.0
        )
        self._position.on_update(client.defer(self._seek))
        moves = gui.add_button_group("Move", MOVES)
        moves.on_click(client.defer(self._move))
        self._rate = gui.add_dropdown("Rate", RATES, initial_value="1")
        self._rate.on_update(client.defer(self._set_rate))

    def update(self, state: PageState) -> None:
        """Request the position, unless a reply is awaited."""
        del state
        if not self._is_asked:
            self._is_asked = True
            self._client.call(GET_STATE, ReplayRequest(), self._show, on_error=self._ask_again)

    def _ask_again(self, _: str) -> None:
        self._is_asked = False

    def _show(self, report: ReplayReport) -> None:
        self._is_asked, self._report = False, report
        length = max(ceil(report.duration_s / SLIDER_STEP_S) * SLIDER_STEP_S, LEAST_DURATION_S)
        if abs(self._position.max - length) >= SLIDER_STEP_S:
            self._position.max = round(length, 1)
        self._position.value = report.position_s  # type: ignore[misc]  # the setter stands apart
        place, end = format_clock(report.position_s), format_clock(report.duration_s)
        state = "paused" if report.is_paused else "playing"
        self._text.content = (
            f'<div style="padding:0.2em 0.8em" role="status">{place} of {end}, {state}</div>'
        )

    def _seek(self, position_s: float) -> None:
        # Also called when `_show` moves the slider.
        if abs(position_s - self._report.position_s) >= SLIDER_STEP_S / 2.0:
            self._client.call(SEEK, ReplaySeekRequest(position_s), self._show)

    def _move(self, move: str) -> None:
        if move == "Play":
            self._client.call(RESUME, ReplayRequest(), self._show)
        elif move == "Pause":
            self._client.call(PAUSE, ReplayRequest(), self._show)
        else:
            target_s = self._report.position_s + float(move.removesuffix(" s"))
            within_s = min(max(target_s, 0.0), self._report.duration_s)
            self._client.call(SEEK, ReplaySeekRequest(within_s), self._show)

    def _set_rate(self, rate: str) -> None:
        if float(rate) != self._report.rate:
            self._client.call(SET_RATE, ReplaySetRateRequest(float(rate)), self._show)
