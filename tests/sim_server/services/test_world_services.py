"""Loading, unloading and listing of worlds, and their refusals."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.sim_server.fakes import (
    WallTime,
    a_world,
    handle_request,
    kinds_of_events,
    make_parts,
    names_in,
)
from tests.sim_server.orders import an_order
from zensim.proto.messages import entity_messages, world_messages
from zensim.proto.messages.entity_messages import TagsFilter
from zensim.proto.messages.result_messages import (
    GetAvailableWorldsCode,
    GetCurrentWorldCode,
    LoadWorldCode,
    ResultCode,
    UnloadWorldCode,
)
from zensim.proto.messages.simulation_messages import (
    ResetSimulationRequest,
    State,
    StepSimulationRequest,
)
from zensim.proto.messages.spawn_messages import Resource
from zensim.sim_server.description.builtin_models import list_builtin_worlds
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import SimError
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.services.world_services import WORLD_BUILD_SLICE_NS
from zensim.sim_server.world.simulated_world import BuiltWorld
from zensim.sim_server.world_loading.world_catalog import (
    FILES_PER_TURN,
    WorldCatalog,
    read_world_metadata,
)

BUILT_IN = list(list_builtin_worlds())

GROUND = "<include><uri>model://ground_plane</uri></include>"
CRATE = (
    "<model name='crate'><link name='box'><inertial><mass>1</mass><inertia><ixx>0.1</ixx>"
    "<iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>{}</link></model>"
)
MESH = "<collision name='c'><geometry><mesh><uri>{}</uri></mesh></geometry></collision>"


def sdf(inside: str = "", name: str = "w") -> str:
    return f"<sdf version='1.6'><world name='{name}'>{GROUND}{inside}</world></sdf>"


def loading(uri: str = "", text: str = "", **options: bool) -> world_messages.LoadWorldRequest:
    return world_messages.LoadWorldRequest(Resource(uri, text), **options)


def loaded(
    parts: ServerParts, request: world_messages.LoadWorldRequest
) -> world_messages.LoadWorldReport:
    later = handle_request(parts, request)
    assert isinstance(later, DeferredResponse)
    while not later.is_ready():
        parts.descriptions.provider.poll()
    report = later.outcome()
    assert isinstance(report, world_messages.LoadWorldReport)
    return report


def listed(parts: ServerParts, request: world_messages.GetAvailableWorldsRequest) -> list[str]:
    return [world.world_resource.uri for world in available(parts, request)]


def available(
    parts: ServerParts, request: world_messages.GetAvailableWorldsRequest
) -> tuple[world_messages.WorldResource, ...]:
    later = handle_request(parts, request)
    assert isinstance(later, DeferredResponse)
    while not later.is_ready():
        pass
    response = later.outcome()
    assert isinstance(response, world_messages.GetAvailableWorldsResponse)
    return response.worlds


@pytest.fixture
def parts() -> ServerParts:
    return make_parts(a_world("r0", "r1"))


@pytest.fixture
def folder(tmp_path: Path, parts: ServerParts) -> Path:
    (tmp_path / "outside.world").write_text(sdf())
    folder = tmp_path / "given"
    folder.mkdir()
    parts.loading.catalog = WorldCatalog([folder])
    return folder


def test_loaded_world_replaces_another(parts: ServerParts) -> None:
    parts.world.step()
    parts.world.claim("a", ("r0",), "stop")
    parts.world.clock.take_events()

    report = loaded(parts, loading("walls"))

    assert (report.world.name, report.world.world_resource.uri) == ("walls", "walls")
    assert names_in(parts.world) == ["outer_walls", "inner_walls"]
    assert (parts.world.clock.state, parts.world.clock.steps, parts.world.clock.epoch) == (
        State.STOPPED,
        0,
        1,
    )
    assert len(parts.world.claims) == 0
    assert parts.current_world.model.name == "walls"
    kinds = kinds_of_events(parts.world)
    assert kinds == ["loading", "deleted", "deleted", "loaded", "spawned", "spawned"]


def test_world_is_stopped_while_another_is_parsed(parts: ServerParts) -> None:
    handle_request(parts, loading("walls"))

    assert parts.world.clock.state == State.LOADING_WORLD
    assert names_in(parts.world) == ["r0", "r1"]
    for request in (an_order("r9"), loading("empty"), world_messages.UnloadWorldRequest()):
        with pytest.raises(SimError) as refused:
            handle_request(parts, request)
        assert refused.value.code == ResultCode.INCORRECT_STATE


def test_world_is_built_over_turns_and_replaced_at_once() -> None:
    wall = WallTime()
    parts = make_parts(a_world("r0"), wall)
    made = parts.loading.factory

    def slowly(model: WorldModel) -> Iterator[BuiltWorld | None]:
        for part in made(model):
            wall.ns += WORLD_BUILD_SLICE_NS
            yield part

    parts.loading.factory = slowly
    later = handle_request(parts, loading("walls"))
    assert isinstance(later, DeferredResponse)
    seen = []
    while not later.is_ready():
        parts.descriptions.provider.poll()
        seen.append(names_in(parts.world))
    later.outcome()

    assert len(seen) > 1
    assert all(names == ["r0"] for names in seen)
    assert names_in(parts.world) == ["outer_walls", "inner_walls"]


def test_world_keeps_its_own_pace() -> None:
    parts = make_parts(a_world())
    pace = "<physics type='ode'><max_step_size>0.002</max_step_size>"
    pace += "<real_time_factor>0.5</real_time_factor></physics>"

    loaded(parts, loading(text=sdf(pace)))

    assert (parts.world.clock.step_ns, parts.pacing.target_real_time_factor) == (2_000_000, 0.5)
    assert parts.world.control_steps == 5


@pytest.mark.parametrize("state", [State.PLAYING, State.PAUSED, State.STOPPED, State.NO_WORLD])
def test_world_stays_as_it_was_when_another_cannot_be_loaded(
    parts: ServerParts, state: State
) -> None:
    parts.world.step()
    parts.world.clock.state = state
    before = (parts.world.clock.steps, parts.world.clock.epoch, names_in(parts.world))

    with pytest.raises(SimError, match=r"xml\.syntax"):
        loaded(parts, loading(text="<sdf"))

    assert parts.world.clock.state == state
    assert (parts.world.clock.steps, parts.world.clock.epoch, names_in(parts.world)) == before


REFUSED = {
    "nothing": (loading(), LoadWorldCode.NO_RESOURCE, "."),
    "a name that is none": (loading("moon"), ResultCode.NOT_FOUND, "moon"),
    "any file": (loading("/etc/passwd"), ResultCode.NOT_FOUND, "/etc/passwd"),
    "a file by URI": (loading("file:///etc/hosts"), ResultCode.NOT_FOUND, "file:"),
    "a file above": (loading("../outside.world"), ResultCode.NOT_FOUND, "outside"),
    "a file by a link": (loading("link.world"), ResultCode.NOT_FOUND, "link"),
    "no SDF": (loading("notes.txt"), LoadWorldCode.UNSUPPORTED_FORMAT, "'.txt'"),
    "a robot": (loading(text="<robot name='r'/>"), LoadWorldCode.UNSUPPORTED_FORMAT, "sdf.root"),
    "a model": (
        loading(text="<sdf version='1.6'><model name='m'/></sdf>"),
        LoadWorldCode.UNSUPPORTED_FORMAT,
        "sdf.world: .*<model>",
    ),
    "no text": (loading("noise.sdf"), LoadWorldCode.RESOURCE_PARSE_ERROR, "noise.sdf"),
    "a missing model": (
        loading(text=sdf("<include><uri>model://tree</uri></include>")),
        LoadWorldCode.MISSING_ASSETS,
        "sdf.include: .*'model://tree'",
    ),
    "a missing mesh": (
        loading(text=sdf(CRATE.format(MESH.format("model://a/a.stl")))),
        LoadWorldCode.MISSING_ASSETS,
        "mesh.missing: .*'model://a/a.stl'",
    ),
    "an unusable mesh": (
        loading(text=sdf(CRATE.format(MESH.format("bad.stl")))),
        LoadWorldCode.UNSUPPORTED_ASSETS,
        "world.unusable: ",
    ),
    "a gravity that tears all apart": (
        loading(text=sdf("<gravity>0 0 1e300</gravity>")),
        LoadWorldCode.RESOURCE_PARSE_ERROR,
        r"sdf\.gravity: .*1e\+300",
    ),
    "a strange element": (
        loading(text=sdf("<wind/>"), fail_on_unsupported_element=True),
        LoadWorldCode.UNSUPPORTED_ELEMENTS,
        "world.unsupported: .*<wind>",
    ),
}


@pytest.mark.parametrize(("request_", "code", "named"), REFUSED.values(), ids=REFUSED)
def test_world_is_refused(
    parts: ServerParts,
    folder: Path,
    request_: world_messages.LoadWorldRequest,
    code: int,
    named: str,
) -> None:
    (folder / "notes.txt").write_text(sdf())
    (folder / "noise.sdf").write_bytes(b"\xff\xfe\xff")
    (folder / "bad.stl").write_bytes(b"no mesh")
    (folder / "link.world").symlink_to(folder.parent / "outside.world")

    with pytest.raises(SimError, match=named) as refused:
        loaded(parts, request_)

    assert refused.value.code == code
    assert names_in(parts.world) == ["r0", "r1"]


def test_world_loads_without_missing_assets_when_allowed(parts: ServerParts, folder: Path) -> None:
    (folder / "bad.stl").write_bytes(b"no mesh")
    lacking = sdf(
        "<include><uri>model://tree</uri></include>"
        + CRATE.format(MESH.format("bad.stl"))
        + CRATE.format(MESH.format("model://a/a.stl")).replace("'crate'", "'other'")
    )

    report = loaded(parts, loading(text=lacking, ignore_missing_or_unsupported_assets=True))

    assert names_in(parts.world) == ["other"]
    subjects = [entry.subject for entry in report.report]
    assert "include 'model://tree'" in subjects
    assert "model 'crate'" in subjects


def test_world_includes_models_of_the_operators_folders(parts: ServerParts, folder: Path) -> None:
    inner = "<include><uri>model://inner</uri></include><joint name='j' type='fixed'>"
    inner += "<parent>box</parent><child>crate::box</child></joint>"
    for name, inside in (("outer", inner), ("inner", "")):
        (folder / name).mkdir()
        text = f"<sdf version='1.6'>{CRATE.format('').replace('</model>', inside + '</model>')}"
        (folder / name / "model.sdf").write_text(text + "</sdf>")
    (folder / "yard.world").write_text(
        sdf("<include><uri>model://outer</uri><name>big</name></include>", "yard")
    )

    report = loaded(parts, loading("yard"))

    assert report.world.name == "yard"
    assert names_in(parts.world) == ["big"]
    assert parts.world.entities.find("big").model.mass_kg == 2.0


def test_world_is_unloaded_with_everything_in_it(parts: ServerParts) -> None:
    handle_request(parts, world_messages.UnloadWorldRequest())

    assert (parts.world.clock.state, names_in(parts.world)) == (State.NO_WORLD, [])
    for request, code in (
        (world_messages.UnloadWorldRequest(), UnloadWorldCode.NO_WORLD_LOADED),
        (world_messages.GetCurrentWorldRequest(), GetCurrentWorldCode.NO_WORLD_LOADED),
        (an_order("r9"), ResultCode.INCORRECT_STATE),
        (StepSimulationRequest(1), ResultCode.INCORRECT_STATE),
        (ResetSimulationRequest(), ResultCode.INCORRECT_STATE),
    ):
        with pytest.raises(SimError) as refused:
            handle_request(parts, request)
        assert refused.value.code == code
    assert (
        handle_request(parts, entity_messages.GetEntitiesRequest())
        == entity_messages.GetEntitiesResponse()
    )

    loaded(parts, loading("empty"))

    assert parts.world.clock.state == State.STOPPED


def test_current_world_is_returned_as_its_resource(parts: ServerParts) -> None:
    text = sdf("<zensim:tags> a b </zensim:tags>", "yard")
    loaded(parts, loading(text=text))

    response = handle_request(parts, world_messages.GetCurrentWorldRequest())

    assert isinstance(response, world_messages.GetCurrentWorldResponse)
    assert response.world == world_messages.WorldResource(
        "yard", Resource("", text), "", ("a", "b")
    )


def test_worlds_are_listed_by_folder_and_tag(parts: ServerParts, folder: Path) -> None:
    (folder / "deep").mkdir()
    (folder / "deep" / "a.world").write_text(sdf("<zensim:tags>indoor cold</zensim:tags>"))
    (folder / "b.sdf").write_text(sdf("<zensim:tags>cold</zensim:tags>"))
    (folder / "model.sdf").write_text("<sdf version='1.6'><model name='m'/></sdf>")
    (folder / "link.world").symlink_to(folder.parent / "outside.world")
    ask = world_messages.GetAvailableWorldsRequest

    assert listed(parts, ask()) == [*BUILT_IN, "b.sdf", "deep/a.world"]
    assert listed(parts, ask(filter=TagsFilter(("cold", "no")))) == ["b.sdf", "deep/a.world"]
    assert listed(parts, ask(filter=TagsFilter(("cold", "indoor"), 1))) == ["deep/a.world"]
    assert "deep/a.world" in listed(parts, ask(additional_sources=("deep",)))


def test_world_has_its_own_description_not_that_of_its_frames(parts: ServerParts) -> None:
    found = available(parts, world_messages.GetAvailableWorldsRequest())

    empty = next(world for world in found if world.world_resource.uri == "empty")
    assert (empty.description, empty.tags) == (
        "Flat ground and nothing on it.",
        ("outdoor", "small"),
    )
    nameless = sdf("<frame name='f'><zensim:tags>parking</zensim:tags></frame>")
    assert loaded(parts, loading(text=nameless)).world.tags == ()


def test_text_with_unclosed_frames_is_searched_in_one_pass() -> None:
    # It would take seconds if each frame searched for its own end.
    text = "<world name='w'><zensim:tags>a, b</zensim:tags>" + "<frame>" * 10_000

    assert read_world_metadata(Resource(), text).tags == ("a", "b")


def test_files_are_searched_a_few_per_turn(parts: ServerParts, folder: Path) -> None:
    for number in range(3 * FILES_PER_TURN):
        (folder / f"{number:03}.world").write_text(sdf())
    later = handle_request(parts, world_messages.GetAvailableWorldsRequest())
    assert isinstance(later, DeferredResponse)

    turns = 1
    while not later.is_ready():
        turns += 1

    assert turns > 3
    assert len(later.outcome().worlds) == len(BUILT_IN) + 3 * FILES_PER_TURN


@pytest.mark.parametrize("source", ["/etc", "..", "nowhere", "https://example.org/worlds"])
def test_source_outside_the_operators_folders_is_not_searched(
    parts: ServerParts, folder: Path, source: str
) -> None:
    with pytest.raises(SimError) as refused:
        listed(parts, world_messages.GetAvailableWorldsRequest(additional_sources=(source,)))

    assert refused.value.code == ResultCode.NOT_FOUND
    lenient = world_messages.GetAvailableWorldsRequest(
        additional_sources=(source,), continue_on_error=True
    )
    assert listed(parts, lenient) == BUILT_IN
    assert folder.is_dir()


def test_online_source_is_skipped_when_only_offline_ones_are_requested(parts: ServerParts) -> None:
    request = world_messages.GetAvailableWorldsRequest(("https://example.org",), offline_only=True)

    assert listed(parts, request) == BUILT_IN


def test_worlds_are_not_listed_when_an_operators_folder_is_missing(
    parts: ServerParts, folder: Path
) -> None:
    folder.rmdir()

    with pytest.raises(SimError) as refused:
        listed(parts, world_messages.GetAvailableWorldsRequest())

    assert refused.value.code == GetAvailableWorldsCode.DEFAULT_SOURCES_FAILED
    assert len(
        listed(parts, world_messages.GetAvailableWorldsRequest(continue_on_error=True))
    ) == len(BUILT_IN)
