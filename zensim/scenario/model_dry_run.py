"""Reads the models and the world of a scenario as a server does, without one: what it refuses."""

from collections.abc import Iterator, Sequence
from os import environ

import msgspec

from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.settings.setting import make_settings
from zensim.proto.settings.start_settings import WorldFileSettings
from zensim.scenario.fault_sections import AGENT_FAULTS, Fault
from zensim.scenario.scenario_format import RobotsSection
from zensim.scenario.scenario_nodes import Issue
from zensim.scenario.scenario_reader import Scenario
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_model
from zensim.sim_server.description.pipeline import parse_description
from zensim.sim_server.errors import SimError
from zensim.sim_server.world_loading.world_loader_process import load_world_file
from zensim.spawner.spawn.asset_bundle import read_assets
from zensim.spawner.spawn.description_sources import read_model_argument
from zensim.spawner.spawn.search_paths import collect_search_paths
from zensim.spawner.spawn.spawn_client import make_payload

REFUSALS = (SimError, ServiceError, OSError, ValueError)


def check_models(scenario: Scenario) -> tuple[Issue, ...]:
    """Find what a server would refuse: the world file, models, and parts that faults name."""
    issues = list(_check_world(scenario))
    models: dict[int, Model] = {}
    for index, group in enumerate(scenario.format.robots):
        path = f"robots[{index}].model"
        try:
            models[index] = read_model(scenario, index, group)
        except REFUSALS as error:
            issues.append(Issue(scenario.find_place(path), path, f"`{group.model}`: {error}"))
            continue
        if group.strict and (report := _list_suspicious(models[index])):
            issues.append(Issue(scenario.find_place(path), path, f"`{group.model}`: {report}"))
    for index, fault in enumerate(scenario.format.faults):
        issues += _check_parts(scenario, index, fault, models)
    return tuple(issues)


def _check_world(scenario: Scenario) -> Iterator[Issue]:
    world = scenario.format.world
    if world.load in list_builtin_worlds():
        return
    file = scenario.find_file("world.load", world.load)
    folders = [scenario.find_file("world.model_paths", one) for one in world.model_paths]
    read = {**msgspec.structs.asdict(world), "model_paths": folders}
    try:
        load_world_file(str(file), make_settings(WorldFileSettings, read))
    except REFUSALS as error:
        yield Issue(scenario.find_place("world.load"), "world.load", f"`{world.load}`: {error}")


def read_model(scenario: Scenario, index: int, group: RobotsSection) -> Model:
    """Read the model of a group.

    Raises:
        SimError: The description is refused.
        ServiceError: A mesh is missing.
        OSError: A file cannot be read.
        ValueError: The description or its xacro cannot be read.
    """
    file = scenario.find_file(f"robots[{index}].model", group.model)
    word = str(file) if file.is_file() else group.model
    folders = [
        scenario.find_file(f"robots[{index}].package_paths", one) for one in group.package_paths
    ]
    paths = collect_search_paths(folders, environ)
    controllers = [
        scenario.find_file(f"robots[{index}].controllers", one) for one in group.controllers
    ]
    description = read_model_argument(word, group.xacro, paths)
    payload = make_payload(description, paths, allow_missing=True, controllers=controllers)
    return parse_description(
        payload.text or read_builtin_model(word),
        assets=read_assets(payload.bundle),
        allow_missing=group.allow_missing,
        compat=group.compat,
        controllers=payload.controllers.texts,
        drive=parse_drive_order(group.drive),
    ).model


def _list_suspicious(model: Model) -> str:
    entries = [one for one in model.report if one.status == "suspicious"]
    return "; ".join(f"{one.subject}: {one.reason}" for one in entries[:3])


def _check_parts(
    scenario: Scenario, index: int, fault: Fault, models: dict[int, Model]
) -> Iterator[Issue]:
    """Check that each robot of a fault has the part that it names."""
    if isinstance(fault, AGENT_FAULTS):
        return
    names = set(scenario.select(fault.robots))
    groups = {one.group for one in scenario.robots if one.name in names}
    for key in ("joint", "link", "sensor"):
        word = getattr(fault, key, "")
        for model in (models[group] for group in sorted(groups) if group in models):
            known = list_parts(model, key)
            if word and word not in known:
                path = f"faults[{index}].{key}"
                listed = ", ".join(known) or "there are none"
                text = f"model {model.name} has no {key} `{word}`; known: {listed}"
                yield Issue(scenario.find_place(path), path, text)


def list_parts(model: Model, key: str) -> Sequence[str]:
    """List the names of the moving joints, links or simulated sensors of a model."""
    if key == "joint":
        return [one.name for one in model.joints if one.kind != "fixed"]
    if key == "link":
        return [one.name for one in model.links]
    return [one.name for one in model.sensors if one.settings is not None]
