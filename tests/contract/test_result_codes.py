"""Result codes of simulation_interfaces 2.1, copied independently."""

from enum import IntEnum

import pytest

from zensim.proto.messages.result_messages import (
    GetAvailableWorldsCode,
    GetCurrentWorldCode,
    LoadWorldCode,
    ResultCode,
    SetEntityStateCode,
    SetSimulationStateCode,
    SpawnCode,
    UnloadWorldCode,
)
from zensim.proto.messages.simulation_messages import Feature, ResetScope, State
from zensim.proto.service_catalog import SERVICES

EVERY_SERVICE = {
    "FEATURE_UNSUPPORTED": 0,
    "OK": 1,
    "NOT_FOUND": 2,
    "INCORRECT_STATE": 3,
    "OPERATION_FAILED": 4,
}
SPAWN = {
    "NAME_NOT_UNIQUE": 101,
    "NAME_INVALID": 102,
    "UNSUPPORTED_FORMAT": 103,
    "NO_RESOURCE": 104,
    "NAMESPACE_INVALID": 105,
    "RESOURCE_PARSE_ERROR": 106,
    "MISSING_ASSETS": 107,
    "UNSUPPORTED_ASSETS": 108,
    "INVALID_POSE": 109,
}
SET_SIMULATION_STATE = {
    "ALREADY_IN_TARGET_STATE": 101,
    "STATE_TRANSITION_ERROR": 102,
    "INCORRECT_TRANSITION": 103,
}
LOAD_WORLD = {
    "UNSUPPORTED_FORMAT": 101,
    "NO_RESOURCE": 102,
    "RESOURCE_PARSE_ERROR": 103,
    "MISSING_ASSETS": 104,
    "UNSUPPORTED_ASSETS": 105,
    "UNSUPPORTED_ELEMENTS": 106,
}
STATES = {"STOPPED": 0, "PLAYING": 1, "PAUSED": 2, "QUITTING": 3, "NO_WORLD": 4, "LOADING_WORLD": 5}
SCOPES = {"DEFAULT": 0, "TIME": 1, "STATE": 2, "SPAWNED": 4, "ALL": 255}
FEATURES = {
    "SPAWNING": 0,
    "DELETING": 1,
    "NAMED_POSES": 2,
    "POSE_BOUNDS": 3,
    "ENTITY_TAGS": 4,
    "ENTITY_BOUNDS": 5,
    "ENTITY_BOUNDS_BOX": 6,
    "ENTITY_BOUNDS_CONVEX": 7,
    "ENTITY_CATEGORIES": 8,
    "SPAWNING_RESOURCE_STRING": 9,
    "ENTITY_STATE_GETTING": 10,
    "ENTITY_STATE_SETTING": 11,
    "ENTITY_INFO_GETTING": 12,
    "ENTITY_INFO_SETTING": 13,
    "SPAWNABLES": 14,
    "SIMULATION_RESET": 20,
    "SIMULATION_RESET_TIME": 21,
    "SIMULATION_RESET_STATE": 22,
    "SIMULATION_RESET_SPAWNED": 23,
    "SIMULATION_STATE_GETTING": 24,
    "SIMULATION_STATE_SETTING": 25,
    "SIMULATION_STATE_PAUSE": 26,
    "STEP_SIMULATION_SINGLE": 31,
    "STEP_SIMULATION_MULTIPLE": 32,
    "STEP_SIMULATION_ACTION": 33,
    "WORLD_LOADING": 40,
    "WORLD_RESOURCE_STRING": 41,
    "WORLD_TAGS": 42,
    "WORLD_UNLOADING": 43,
    "WORLD_INFO_GETTING": 44,
    "AVAILABLE_WORLDS": 45,
    "SPAWNING_ENTITIES": 50,
}


@pytest.mark.parametrize(
    ("family", "numbers"),
    [
        (ResultCode, EVERY_SERVICE),
        (SpawnCode, SPAWN),
        (SetEntityStateCode, {"INVALID_POSE": 101}),
        (SetSimulationStateCode, SET_SIMULATION_STATE),
        (LoadWorldCode, LOAD_WORLD),
        (UnloadWorldCode, {"NO_WORLD_LOADED": 101}),
        (GetCurrentWorldCode, {"NO_WORLD_LOADED": 101}),
        (GetAvailableWorldsCode, {"DEFAULT_SOURCES_FAILED": 101}),
        (State, STATES),
        (ResetScope, SCOPES),
        (Feature, FEATURES),
    ],
)
def test_codes_match_simulation_interfaces(family: type[IntEnum], numbers: dict[str, int]) -> None:
    assert {member.name: member.value for member in family} == numbers


@pytest.mark.parametrize(
    ("service", "family"),
    [
        ("spawn_entity", SpawnCode),
        ("set_entity_state", SetEntityStateCode),
        ("set_simulation_state", SetSimulationStateCode),
        ("load_world", LoadWorldCode),
        ("unload_world", UnloadWorldCode),
        ("get_current_world", GetCurrentWorldCode),
        ("get_available_worlds", GetAvailableWorldsCode),
    ],
)
def test_service_returns_its_own_codes(service: str, family: type[IntEnum]) -> None:
    assert SERVICES[service].codes is family


@pytest.mark.parametrize("service", SERVICES)
def test_codes_of_a_service_are_its_own_and_above_100(service: str) -> None:
    codes = [code.value for code in SERVICES[service].codes]

    assert all(100 < code <= 255 for code in codes)
