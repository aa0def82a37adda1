"""The public names: listed, documented, and imported when they are used."""

import inspect
import json
import pickle
import subprocess
import sys

import pytest

import zensim
from tests.zensim.api.api_surface import DOCUMENT, describe_surface
from zensim.deploy.cli import VERBS
from zensim.public_names import list_public_names

HEAVY = ("zenoh", "numpy", "typer", "rich", "pybullet", "mujoco", "yourdfpy", "msgspec")
NAMES = [name for name in list_public_names() if name[0] != "_"]
ERRORS = [
    name
    for name in NAMES
    if inspect.isclass(found := getattr(zensim, name)) and issubclass(found, zensim.Error)
]


def test_surface_is_the_listed_one() -> None:
    listed = json.loads(DOCUMENT.read_text(encoding="utf-8"))

    assert listed == describe_surface(), "run 'python -m tests.zensim.api.api_surface'"


def test_names_for_type_checkers_are_those_at_run_time() -> None:
    assert sorted(zensim.__all__) == NAMES


def test_import_loads_nothing_heavy() -> None:
    code = f"import sys, zensim; print([one for one in {HEAVY} if one in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )

    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", NAMES)
def test_public_name_is_documented_with_its_members(name: str) -> None:
    found = getattr(zensim, name)
    members = inspect.getmembers(found) if inspect.isclass(found) else []
    ours = [one for key, one in members if key[0] != "_" and callable(one)]

    undocumented = [one for one in (found, *ours) if not inspect.getdoc(one)]

    assert undocumented == []


@pytest.mark.parametrize("name", ERRORS)
def test_error_is_pickled_with_all_it_says(name: str) -> None:
    error = getattr(zensim, name)("given", slug="a_slug", hint="what works", code=3)

    again = pickle.loads(pickle.dumps(error))

    assert type(again) is type(error)
    said = (again.message, again.slug, again.hint, again.code, str(again))
    assert said == ("given", "a_slug", "what works", 3, "given; what works")


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError):
        _ = zensim.nothing_of_this_name


METHODS = {
    "up": "launch",
    "bag": "Recording",
    "down": "Sim.close",
    "record": "Simulation.record",
    "serve": "launch",
    "agent": "Simulation.attach",
    "spawn": "Simulation.spawn",
    "fleet": "Simulation.spawn_fleet",
    "list": "Simulation.entities",
    "inspect": "EntityHandle.report",
    "delete": "Simulation.delete",
    "set": "EntityHandle.set_pose",
    "pause": "Simulation.pause",
    "play": "Simulation.play",
    "reset": "Simulation.reset",
    "step": "Simulation.step",
    "run-to": "Simulation.run_to",
    "rtf": "Sim.set_speed",
    "world": "Simulation.load",
    "drive": "Robot.drive",
    "topic": "Sim.topics",
    "echo": "Topic.read",
    "hz": "Topic.rate",
    "sensors": "Robot.sensors",
    "model": "Simulation.check",
    "version": "__version__",
    "view": "Sim.show",
    "export": "export",
}
"""By verb of the command line: what does the same in Python."""
WITHOUT_METHOD = {
    "router": "a program of the network, not of a simulation",
    "stop": "reset() and pause()",
    "map": "call(GET_MAP, ...): its file is for Nav2",
    "features": "call(GET_SIMULATOR_FEATURES, ...)",
    "stats": "topic('sim/WORLD/stats').read()",
    "doctor": "diagnoses why nothing connects",
    "check": "a report on a folder of robots, for terminals",
    "test": "runs files; in Python, tests use zensim.testing",
    "sweep": "runs files; in Python, a loop over zensim.load",
    "config": "shows the settings of commands",
    "scenario": "checks and lists files",
    "token": "for operators of secured servers, whose folder it reads",
    "join": "keeps a token for later; in Python, connect(token=...)",
    "journal": "reads files of servers that have ended",
    "foxglove": "a program beside the simulation",
    "vda5050": "a program beside the simulation",
    "teleop": "keys of a terminal; Robot.drive",
    "top": "a screen of a terminal; topics and statistics have its figures",
    "replay": "a program beside the simulation: it publishes a file",
    "resim": "runs a recording, not a world that is there",
}


@pytest.mark.parametrize("verb", VERBS)
def test_verb_has_a_method_or_a_reason(verb: str) -> None:
    assert (verb in METHODS) != (verb in WITHOUT_METHOD)
    found: object = zensim
    for name in METHODS.get(verb, "").split(".") if verb in METHODS else ():
        found = getattr(found, name)
    assert found is not None
