"""Loads a scenario file into a world: in this process, or one that runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zensim.api.simulation import Simulation
from zensim.api.world_access import api_errors
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.settings.server_settings import ServerSettings, WorldKeywords
from zensim.proto.settings.setting import list_settings
from zensim.scenario.scenario_reader import Scenario, find_scenario_file, read_scenario
from zensim.scenario.scenario_runner import ScenarioFailed, ScenarioRun

if TYPE_CHECKING:
    from zensim.api.in_process_world import World


def open_world(scenario: Scenario) -> "World":
    """Load the world of a scenario in this process, without its robots.

    Raises:
        ScenarioFailed: It needs what a world in process has not.
        Invalid: There is no such world, or it is refused.
    """
    # Imported here: it needs the server extra, and reading a scenario does not.
    from zensim.api.in_process_world import World  # noqa: PLC0415

    engine, world = scenario.format.engine, scenario.format.world
    if engine.workers:
        raise ScenarioFailed(
            f"engine.workers is {engine.workers}, and a world in process has none; use 0 or null, "
            "or 'zensim test --server'"
        )
    file = scenario.find_file("world.load", world.load)
    return World(
        file if file.is_file() else world.load,
        **list_world_keywords(scenario),
        rates=find_agent_rates(scenario),
    )


def list_world_keywords(scenario: Scenario) -> dict[str, Any]:
    """List the keywords of `World` that are settings of a server; null and empty ones are not."""
    values = {
        field.name: scenario.find_value(field.setting.key)
        for field in list_settings(ServerSettings)
        if field.name in WorldKeywords.__annotations__
    }
    folders = [scenario.find_file("world.model_paths", one) for one in values["model_paths"]]
    return {
        **{name: value for name, value in values.items() if value not in (None, "")},
        "model_paths": folders,
    }


def find_agent_rates(scenario: Scenario) -> dict[str, RateOverrides]:
    """Find the rates of odometry and tf that `agents` sets, by robot; the first that names it."""
    rates: dict[str, RateOverrides] = {}
    for entry in scenario.format.agents if scenario.robots else ():
        for name in scenario.select(entry.drives):
            rates.setdefault(name, RateOverrides(entry.odom_rate, entry.tf_rate))
    return rates


def load(
    file: str | Path,
    settings: Sequence[str] = (),
    *,
    sim: Simulation | None = None,
    python: bool = True,
) -> ScenarioRun:
    """Read a scenario file, and spawn its robots.

    Args:
        file: Its path, or the name of a shipped scenario.
        settings: `KEY.PATH=VALUE`, which win over the file.
        sim: World to use; None = one in this process, which the run closes.
        python: Whether `python:` may run code of the file's author.

    Returns:
        The run: `run()` runs it to its end and returns the report; `sim` is its world.

    Raises:
        NotFound: There is no such file or scenario.
        ScenarioInvalid: It has mistakes; all of them are in the message.
        Error: The world refused a part of it.
    """
    with api_errors():
        path = find_scenario_file(str(file))
    scenario = read_scenario(path, settings)
    world = open_world(scenario) if sim is None else sim
    try:
        run = ScenarioRun(scenario, world, allows_python=python)
        run.spawn()
    except BaseException:
        if sim is None:
            world.close()
        raise
    run.owns_world = sim is None
    return run
