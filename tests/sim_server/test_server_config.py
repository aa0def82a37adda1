"""Server configuration and its validation."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.sim_server.changed_configs import with_settings
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.settings.pace_settings import CONTROL_HZ
from zensim.sim_server.server_config import (
    ConfigError,
    ServerConfig,
    fill_pace,
    make_server_bus_config,
    validate_config,
)

DEFAULTS = ServerConfig(bus=BusConfig())


def test_config_defaults_are_valid() -> None:
    assert validate_config(DEFAULTS) == DEFAULTS


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"world_name": "my world"}, "'my world'"),
        ({"world_name": ""}, "''"),
        ({"step_hz": 0.0}, "`step_hz` 0"),
        ({"step_hz": -240.0}, "`step_hz` -240"),
        ({"step_hz": 1e6}, r"`step_hz` 1e\+06"),
        ({"step_hz": float("nan")}, "`step_hz` nan"),
        ({"control_hz": 0.0}, "`control_hz` 0"),
        ({"control_hz": float("nan")}, "`control_hz` nan"),
        ({"rtf": -1.0}, r"`rtf` -1"),
        ({"rtf": float("inf")}, "`rtf` inf"),
        ({"rtf": float("nan")}, "`rtf` nan"),
        ({"lockstep_timeout": 0.0}, "`lockstep_timeout` 0"),
        ({"lockstep_timeout": float("nan")}, "`lockstep_timeout` nan"),
        ({"seed": -1}, "`seed` -1"),
    ],
    ids=str,
)
def test_config_is_refused_with_the_value(changes: dict[str, object], named: str) -> None:
    config = with_settings(DEFAULTS, **changes)

    with pytest.raises(ConfigError, match=named):
        validate_config(config)


@pytest.mark.parametrize(
    ("step_hz", "step_ns", "control_steps"),
    [
        (1.0, 1_000_000_000, 1),
        (60.0, 16_666_667, 1),
        (100.0, 10_000_000, 1),
        (101.0, 9_900_990, 2),
        (240.0, 4_166_667, 3),
        (1000.0, 1_000_000, 10),
        (10_000.0, 100_000, 100),
    ],
)
def test_config_computes_step_and_control_period(
    step_hz: float, step_ns: int, control_steps: int
) -> None:
    config = with_settings(DEFAULTS, step_hz=step_hz)

    assert (config.step_ns, config.control_steps) == (step_ns, control_steps)


@pytest.mark.parametrize(("control_hz", "steps"), [(50.0, 5), (240.0, 1), (1000.0, 1), (10.0, 24)])
def test_drive_states_have_the_requested_rate(control_hz: float, steps: int) -> None:
    assert with_settings(DEFAULTS, step_hz=240.0, control_hz=control_hz).control_steps == steps


@given(st.floats(1.0, 10_000.0))
def test_drive_states_have_at_most_the_control_rate(step_hz: float) -> None:
    config = with_settings(DEFAULTS, step_hz=step_hz)

    assert config.control_steps >= 1
    assert NANOSECONDS / config.step_ns / config.control_steps <= CONTROL_HZ * (1 + 1e-6)


def test_server_is_a_router_at_the_default_endpoint() -> None:
    assert make_server_bus_config("", "") == BusConfig(mode="router", listen=(DEFAULT_ENDPOINT,))


def test_server_is_a_router_at_the_listen_endpoint() -> None:
    assert make_server_bus_config("tcp/0.0.0.0:1", "") == BusConfig(
        mode="router", listen=("tcp/0.0.0.0:1",)
    )


def test_server_is_a_client_of_the_connect_endpoint() -> None:
    assert make_server_bus_config("", "tcp/h:1") == BusConfig(mode="client", connect=("tcp/h:1",))


@pytest.mark.parametrize(
    ("asked", "written", "expected"),
    [
        ((None, None), (None, None), (240.0, 1.0)),
        ((None, None), (0.001, 0.5), (1000.0, 0.5)),
        ((None, None), (None, 0.0), (240.0, 0.0)),
        ((100.0, 0.0), (0.001, 0.5), (100.0, 0.0)),
    ],
)
def test_pace_is_requested_or_of_the_world_file_or_the_default(
    asked: tuple[float | None, float | None],
    written: tuple[float | None, float | None],
    expected: tuple[float, float],
) -> None:
    config = with_settings(DEFAULTS, step_hz=asked[0], rtf=asked[1])

    found = fill_pace(config, step_s=written[0], real_time_factor=written[1])

    assert (found.settings.pace.step_hz, found.settings.pace.rtf) == expected


@pytest.mark.parametrize(
    ("control_hz", "step_hz", "control_steps"),
    [
        (100.0, 100.0, 1),
        (20.0, 20.0, 1),
        (50.0, 50.0, 1),
        (15.0, 30.0, 2),
        (6.7, 20.1, 3),
        (1.0, 20.0, 20),
        (1000.0, 240.0, 1),
    ],
)
def test_kinematic_world_steps_at_its_control_rate_within_bounds(
    control_hz: float, step_hz: float, control_steps: int
) -> None:
    config = with_settings(DEFAULTS, control_hz=control_hz, dynamics="kinematic")

    found = fill_pace(config, step_s=None, real_time_factor=None)

    assert found.settings.pace.step_hz == pytest.approx(step_hz)
    assert (found.control_steps, config.control_steps) == (control_steps, control_steps)
    assert config.step_ns == found.step_ns


@pytest.mark.parametrize(
    ("asked", "written", "expected"), [(60.0, None, 60.0), (None, 0.01, 100.0)]
)
def test_kinematic_world_has_the_step_rate_that_is_given(
    asked: float | None, written: float | None, expected: float
) -> None:
    config = with_settings(DEFAULTS, step_hz=asked, control_hz=20.0, dynamics="kinematic")

    found = fill_pace(config, step_s=written, real_time_factor=None)

    assert found.settings.pace.step_hz == expected


@pytest.mark.parametrize("control_hz", [15.0, 30.0, 48.0, 60.0, 75.0, 90.0, 120.0])
def test_control_steps_do_not_change_by_the_rounding_of_a_step(control_hz: float) -> None:
    config = with_settings(DEFAULTS, control_hz=control_hz, dynamics="kinematic")

    resumed = with_settings(config, step_hz=NANOSECONDS / config.step_ns)

    assert resumed.control_steps == config.control_steps
