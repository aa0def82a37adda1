"""`python -m tests.integration.keep_journal`: keep a journal of this version for later ones.

It writes `kept_journals/VERSION`: a journal of a world with robots, a mesh and a deleted robot, and
what a server said about it. A release keeps one (docs/packages.md); later versions must open it.
"""

import json
import shutil
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import TypedDict

import trimesh

from tests.integration.journals import serving_with_journal
from tests.integration.processes import Server, free_endpoint
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import Point, Pose
from zensim.sim_server.journal.sqlite_store import DATABASE, FILES

KEPT = Path(__file__).parent / "kept_journals"
EXPECTED = "expected.json"
JOURNAL = "journal"
CUBE = (
    '<robot name="cube"><link name="a"><inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<collision><geometry><mesh filename="cube.stl"/></geometry></collision></link></robot>'
)


def main() -> None:
    """Make the journal of this version, in place of one that is there."""
    target = KEPT / version("zensim")
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        with serving_with_journal(work / "used", free_endpoint()) as server:
            fill_world(server, work)
            expected = describe_world(server)
        shutil.rmtree(target, ignore_errors=True)
        (target / JOURNAL).mkdir(parents=True)
        shutil.copy2(work / "used" / DATABASE, target / JOURNAL)
        shutil.copytree(work / "used" / FILES, target / JOURNAL / FILES)
    text = json.dumps(expected, indent=2, sort_keys=True)
    (target / EXPECTED).write_text(f"{text}\n", encoding="utf-8")


def fill_world(server: Server, folder: Path) -> None:
    """Spawn robots and a mesh, delete one, place one, and pause."""
    trimesh.creation.box((1.0, 1.0, 1.0)).export(folder / "cube.stl")
    (folder / "cube.urdf").write_text(CUBE)
    server.zensim("spawn", "box_bot", "--name", "r1", "--namespace", "fleet/r1").check_returncode()
    server.zensim("spawn", "car_bot", "--name", "r2", "-x", "2").check_returncode()
    server.zensim("spawn", "box_bot", "--name", "gone", "-x", "4").check_returncode()
    server.zensim(
        "spawn", str(folder / "cube.urdf"), "--name", "cube", "-y", "5", "-z", "0.5"
    ).check_returncode()
    server.zensim("delete", "gone").check_returncode()
    server.client.set_simulation_state(State.PAUSED)
    server.client.set_entity_state("r1", EntityState(pose=Pose(Point(3.0, 4.0, 0.06))))


class KeptWorld(TypedDict):
    """What a server that opens the journal must have."""

    places: dict[str, list[float]]
    state: str


def describe_world(server: Server) -> KeptWorld:
    """Describe the entities and the state of a server."""
    places = {}
    for name in server.client.entities():
        place = server.client.entity_state(name).pose.position
        places[name] = [round(place.x, 3), round(place.y, 3), round(place.z, 3)]
    return KeptWorld(places=places, state=server.client.info().state)


if __name__ == "__main__":
    main()
