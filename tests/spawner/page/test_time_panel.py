"""Wanted and reached real-time factor, and why it is not reached."""

import msgspec
import pytest

from zensim.proto.messages.telemetry_messages import Stats
from zensim.spawner.page.side_panel import AMBER
from zensim.spawner.page.time_panel import explain_shortfall, make_factor_html

STEP_S = 1.0 / 240.0
REACHED = Stats(state="playing", real_time_factor=0.99, target_real_time_factor=1.0)
SHORT = msgspec.structs.replace(REACHED, real_time_factor=0.5)


@pytest.mark.parametrize(
    "stats",
    [
        REACHED,
        msgspec.structs.replace(SHORT, state="paused"),
        msgspec.structs.replace(SHORT, real_time_factor=0.0),
        msgspec.structs.replace(SHORT, target_real_time_factor=0.0),
    ],
    ids=["reached", "paused", "not measured", "as fast as possible"],
)
def test_a_factor_that_is_reached_or_has_no_goal_needs_no_reason(stats: Stats) -> None:
    assert explain_shortfall(stats, STEP_S) == ""
    assert AMBER not in make_factor_html(stats, STEP_S)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"step_time_s": 2.0 * STEP_S}, "engine"),
        ({"awaited": ("pool0", "sensors/s0")}, "pool0, sensors/s0"),
        ({"late_max_s": 0.05, "busy_max_s": 0.001}, "host"),
    ],
)
def test_a_shortfall_is_amber_and_names_engine_agents_or_host(
    changes: dict[str, object], word: str
) -> None:
    stats = msgspec.structs.replace(SHORT, **changes)

    html = make_factor_html(stats, STEP_S)

    assert word in explain_shortfall(stats, STEP_S)
    assert word in html
    assert AMBER in html


def test_names_of_agents_are_no_html() -> None:
    stats = msgspec.structs.replace(SHORT, awaited=("<b>",))

    assert "<b>" not in make_factor_html(stats, STEP_S)
