"""World files are inspected without a server."""

from pathlib import Path

import pytest

from tests.sim_server.world_loading.test_world_loader import CRATE, a_file
from zensim.deploy.cli.inspect_commands import format_world
from zensim.proto.engine_proofs import EngineName
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.description.builtin_models import list_builtin_worlds
from zensim.sim_server.physics.engine_config import find_installed_engines
from zensim.sim_server.world_loading.world_inspection import (
    InspectionRequest,
    WorldInspection,
    find_world_files,
    group_entries,
    inspect_in_process,
    inspect_world,
)
from zensim.sim_server.world_loading.world_loader import WorldLoaderRequest

SOLID = "<collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision></link>"
BOX = CRATE.replace("</link>", SOLID)


def inspect(file: str, engine: EngineName | None = None, settle_s: float = 0.0) -> WorldInspection:
    order = WorldLoaderRequest(file)
    return inspect_world(
        InspectionRequest(world=order, settle_s=settle_s, options=EngineSettings(engine=engine))
    )


def test_inspection_lists_models_lights_and_frames(tmp_path: Path) -> None:
    light = "<light name='lamp' type='point'/><frame name='dock'/>"

    found = inspect(a_file(tmp_path, BOX + light))

    assert [(model.name, model.is_static) for model in found.models] == [("crate", False)]
    assert (found.lights, found.frames, found.has_ground) == (("lamp (point)",), ("dock",), True)
    assert found.fault == ""


@pytest.mark.parametrize("engine", find_installed_engines())
def test_model_that_keeps_falling_is_named(tmp_path: Path, engine: EngineName) -> None:
    rests = BOX.replace("crate", "rests").replace("<link", "<pose>0 0 0.5 0 0 0</pose><link", 1)
    falls = CRATE.replace("crate", "falls").replace("<link", "<pose>5 0 9 0 0 0</pose><link", 1)

    found = inspect(a_file(tmp_path, rests + falls), engine, 0.5)

    assert [model.name for model in found.moving] == ["falls"]


@pytest.mark.parametrize("engine", find_installed_engines())
def test_pendulum_that_swings_moves_and_is_printed(tmp_path: Path, engine: EngineName) -> None:
    joint = (
        "<joint name='j' type='revolute'><parent>world</parent><child>arm</child>"
        "<pose>0.7 0 0 0 0 0</pose><axis><xyz>0 1 0</xyz></axis></joint>"
    )
    body = "<pose>0 0 5 0 0 0</pose><link name='arm'><inertial><mass>1</mass></inertial>" + SOLID
    physics = "<physics><real_time_factor>0.5</real_time_factor></physics>"

    found = inspect(
        a_file(tmp_path, f"{physics}<model name='pendulum'>{body}{joint}</model>"), engine, 0.3
    )

    assert [model.name for model in found.moving] == ["pendulum"]
    assert found.moving[0].joint_speed > 1.0
    assert "real-time factor 0.5" in "".join(format_world(found))


@pytest.mark.parametrize("engine", find_installed_engines())
@pytest.mark.parametrize("name", list_builtin_worlds())
def test_builtin_world_stands_still(name: str, engine: EngineName) -> None:
    found = inspect(name, engine, 1.0)

    assert (found.fault, found.name, found.moving) == ("", name.replace("empty", "default"), ())


@pytest.mark.parametrize("engine", find_installed_engines())
def test_models_that_overlap_are_named_and_part_slowly(tmp_path: Path, engine: EngineName) -> None:
    chairs = [
        BOX.replace("crate", name).replace("<link", f"<pose>{x} 0 0.5 0 0 0</pose><link", 1)
        for name, x in (("sofa", 0.0), ("chair", 0.9), ("far", 5.0))
    ]

    found = inspect(a_file(tmp_path, "".join(chairs)), engine, 0.1)

    assert found.overlaps == (("sofa", ("chair",)),)
    assert 0.0 < max(model.speed_mps for model in found.models) < 0.3


def test_world_is_inspected_alike_in_a_process(tmp_path: Path) -> None:
    request = InspectionRequest(world=WorldLoaderRequest(a_file(tmp_path, BOX)), settle_s=0.1)

    found, expected = inspect_in_process(request), inspect_world(request)

    assert found.models == expected.models != ()


def test_refused_world_has_its_fault(tmp_path: Path) -> None:
    found = inspect(a_file(tmp_path, "<include><uri>model://elm</uri></include>"))

    assert found.fault.startswith("sdf.include: ")


def test_entries_that_differ_in_names_are_one_group() -> None:
    entries = [
        ReportEntry("ignored", f"m{number}: link 'l{number}': <frame>", "no effect")
        for number in range(3)
    ]

    (group,) = group_entries(entries)

    assert (group.subject, group.count) == ("link *: <frame>", 3)


def test_world_files_are_found_below_a_folder(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "a.world").write_text("<sdf version='1.6'><world name='a'/></sdf>")
    (tmp_path / "model.sdf").write_text("<sdf version='1.6'><model name='m'/></sdf>")

    assert [file.name for file in find_world_files(tmp_path)] == ["a.world"]
