"""The tab "Time": steps, run-to and real-time factor."""

import time
from typing import Final

import msgspec

from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    ResetScope,
    ResetSimulationRequest,
    RunToRequest,
    SetSimulationStateRequest,
    SetSpeedRequest,
    SimulationState,
    State,
    StepSimulationRequest,
)
from zensim.proto.messages.standard_messages import NANOSECONDS, time_from_ns
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.printable_text import to_html
from zensim.proto.service_catalog import (
    CANCEL_STEPS,
    RESET_SIMULATION,
    RUN_TO,
    SET_SIMULATION_STATE,
    SET_SPEED,
    STEP_SIMULATION,
)
from zensim.spawner.page.page_theme import MUTED_BUTTON
from zensim.spawner.page.shortcuts import PLAY_OR_PAUSE, RESET, STEP_ONCE
from zensim.spawner.page.side_panel import AMBER, is_short
from zensim.spawner.page.viewer_client import PageState, Panel, ViewerClient
from zensim.spawner.page.world_calls import RESET_TIMEOUT_S
from zensim.spawner.page.world_run import RunActive, WorldRun

ENGINE_SHARE: Final = 0.7
"""Share of the wall time of a step above which the engine is the reason."""
MAX_FACTOR: Final = 10.0
RUN_TIMEOUT_S: Final = 3600.0
SETTLE_S: Final = 1.2
"""Statistics that arrive within this time after a change may be older than the change."""
STEPS: Final = ("1 step", "10 steps", "1 s")


class TimePanel(Panel):
    """Controls the time of the world."""

    def __init__(self, client: ViewerClient, run: WorldRun) -> None:
        """Add the controls.

        Args:
            client: The visitor.
            run: Of the world, to a time; all visitors share it.
        """
        self._client, self._run = client, run
        self._wanted_factor = 1.0
        self._before: Stats | None = None
        self._step_s = 0.0
        self._settled_at = 0.0
        gui = client.gui
        self._text = gui.add_html("")
        steps = gui.add_button_group("Step", STEPS, hint=f"Pauses before; {STEP_ONCE.keys}")
        steps.on_click(client.defer(self.step))
        self._speed = gui.add_slider(
            "Speed",
            min=0.0,
            max=MAX_FACTOR,
            step=0.1,
            initial_value=1.0,
            hint="Wanted real-time factor; 0 = as fast as possible.",
        )
        self._speed.on_update(client.defer(self.set_factor))
        self._goal = gui.add_number("Time [s]", 10.0, min=0.0, max=1e9, step=0.1)
        begin = gui.add_button("Run to this time", hint="Pauses there.")
        begin.on_click(lambda _: client.post(self.run_to))
        cancel = gui.add_button(
            "Cancel run", color=MUTED_BUTTON, hint="Also that of another visitor."
        )
        cancel.on_click(lambda _: client.post(self.cancel_run))
        self._run_text = gui.add_html("")
        client.add_command(PLAY_OR_PAUSE, self.play_or_pause)
        client.add_command(STEP_ONCE, lambda: self.step(STEPS[0]))
        client.add_command(RESET, self._reset)

    def update(self, state: PageState) -> None:
        """Show the wanted and the reached real-time factor, and why it is not reached."""
        self._show_run()
        stats = state.status.stats
        if stats is None or time.monotonic() < self._settled_at:
            return
        if self._before is None or stats.steps < self._before.steps:
            self._before = stats
        elif stats.steps > self._before.steps:
            passed_s = stats.sim_time_s - self._before.sim_time_s
            self._step_s = max(0.0, passed_s / (stats.steps - self._before.steps))
            self._before = stats
        if stats.target_real_time_factor != self._wanted_factor:
            self._wanted_factor = stats.target_real_time_factor
            self._speed.value = min(MAX_FACTOR, self._wanted_factor)  # type: ignore[misc]
        self._text.content = make_factor_html(stats, self._step_s)

    def play_or_pause(self) -> None:
        """Pause a simulation that plays; else play."""
        self._set_state(State.PAUSED if self._is_playing else State.PLAYING)

    def step(self, label: str) -> None:
        """Pause, and advance by a label of `STEPS`."""
        if label == STEPS[-1]:
            self._run_to(self._client.state.status.sim_time_s + 1.0)
        else:
            self._pause()
            request = StepSimulationRequest(steps=int(label.partition(" ")[0]))
            self._client.call(STEP_SIMULATION, request)

    def set_factor(self, factor: float) -> None:
        """Set the wanted real-time factor."""
        if factor != self._wanted_factor:
            self._wanted_factor = factor
            # Statistics that come before the reply have the factor of before.
            self._settled_at = time.monotonic() + SETTLE_S
            self._client.call(
                SET_SPEED, SetSpeedRequest(factor), lambda _: self._show_factor(factor)
            )

    def _show_factor(self, factor: float) -> None:
        """Show the factor that is wanted now; the next statistics may come in a second."""
        stats = self._before or Stats()
        self._before = msgspec.structs.replace(stats, target_real_time_factor=factor)
        self._text.content = make_factor_html(self._before, self._step_s)
        self._settled_at = time.monotonic() + SETTLE_S

    def run_to(self) -> None:
        """Pause, and advance to the time in the form."""
        self._run_to(self._goal.value)

    def cancel_run(self) -> None:
        """End the run to a time, and all other requests for steps."""
        self._run.cancel()
        self._client.call(CANCEL_STEPS, CancelStepsRequest())

    def _show_run(self) -> None:
        """Say that the world runs to a time, and for whom."""
        text, visitor = "", self._run.visitor
        if visitor is not None:
            who = "" if visitor == self._client.client.client_id else ", for another visitor"
            text = _make_text_html(f"Running to {self._run.goal_s:g} s{who}")
        if self._run_text.content != text:
            self._run_text.content = text

    @property
    def _is_playing(self) -> bool:
        return self._client.state.status.state == "playing"

    def _pause(self) -> None:
        if self._is_playing:
            self._set_state(State.PAUSED)

    def _set_state(self, state: State) -> None:
        request = SetSimulationStateRequest(state=SimulationState(state=state))
        self._client.call(SET_SIMULATION_STATE, request)

    def _run_to(self, time_s: float) -> None:
        try:
            number = self._run.begin(self._client.client.client_id, time_s)
        except RunActive as active:
            self._client.warn(str(active))
            return
        if time_s >= self._client.state.status.sim_time_s:  # else the server refuses it
            self._pause()
        request = RunToRequest(time_from_ns(round(time_s * NANOSECONDS)))

        def end(_: object) -> None:
            self._run.end(number)

        self._client.call(RUN_TO, request, end, RUN_TIMEOUT_S, end)

    def _reset(self) -> None:
        scope = ResetScope.TIME | ResetScope.STATE
        request = ResetSimulationRequest(scope=scope)
        self._client.call(RESET_SIMULATION, request, timeout_s=RESET_TIMEOUT_S)


def make_factor_html(stats: Stats, step_s: float) -> str:
    """Write the reached beside the wanted real-time factor, in amber with the reason if short."""
    wanted = stats.target_real_time_factor
    goal = f"of {wanted:.2f} wanted" if wanted else "as fast as possible"
    reason = explain_shortfall(stats, step_s)
    colour = f"color:{AMBER};" if reason else ""
    text = f"Real-time factor {stats.real_time_factor:.2f} {goal}"
    note = f": {reason}" if reason else ""
    return _make_text_html(text + note, colour)


def _make_text_html(text: str, style: str = "") -> str:
    return f'<div style="{style}padding:.15em .7em;font-size:.85em">{to_html(text)}</div>'


def explain_shortfall(stats: Stats, step_s: float) -> str:
    """Explain why the wanted real-time factor is not reached; empty if it is, or while paused.

    Args:
        stats: Newest of the server.
        step_s: Simulation time of a step; 0 = unknown.
    """
    wanted, reached = stats.target_real_time_factor, stats.real_time_factor
    if not is_short(stats.state, reached, wanted):
        return ""
    wall_s = step_s / reached
    if wall_s and stats.step_time_s >= ENGINE_SHARE * wall_s:
        engine_ms, wall_ms = 1e3 * stats.step_time_s, 1e3 * wall_s
        return f"the engine needs {engine_ms:.1f} of {wall_ms:.1f} ms per step"
    if stats.awaited:
        return f"the server waits for {', '.join(stats.awaited)}"
    late_ms, busy_ms = 1e3 * stats.late_max_s, 1e3 * stats.busy_max_s
    return f"the host is busy: steps up to {late_ms:.0f} ms late, {busy_ms:.0f} ms of them its own"
