"""Claims by name, and shares of pools."""

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_box, a_cart, on_ground
from tests.sim_server.fakes import CONTROL_STEPS, a_spawn, a_world, handle_request, make_parts
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages import agent_messages
from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.model_messages import GroundTruth, JointStatePublisher, Sensor
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.sensing_messages import Environment, SphericalCoordinates
from zensim.proto.messages.sensor_messages import ImuSensor
from zensim.proto.messages.telemetry_messages import GetModelsRequest, GetModelsResponse
from zensim.sim_server.description.world_model import EARTH_MAGNETIC_FIELD, WorldModel
from zensim.sim_server.errors import IncorrectState, RequestRefused
from zensim.sim_server.parser_process.description_cache import ParseKey
from zensim.sim_server.parser_process.mesh_server import PublishedFiles
from zensim.sim_server.service_parts import ServerParts, ShareGrace
from zensim.sim_server.services import claim_services
from zensim.sim_server.services.claim_services import (
    START_NS,
    WrongProtocol,
    find_robots_to_move,
    split_evenly,
)
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.entity_store import EntityStore
from zensim.sim_server.world.spawn_request import ValidatedSpawn

MANY = 1 << 32
LIMITS = st.lists(st.integers(0, 30), min_size=1, max_size=6)


@pytest.mark.parametrize(
    ("total", "limits", "given"),
    [
        (10, [MANY], (10,)),
        (10, [MANY, MANY, MANY], (4, 3, 3)),
        (10, [2, MANY, MANY], (2, 4, 4)),
        (10, [1, 2, 3], (1, 2, 3)),
        (0, [MANY, MANY], (0, 0)),
    ],
)
def test_shares_are_even_within_limits(
    total: int, limits: list[int], given: tuple[int, ...]
) -> None:
    assert split_evenly(total, limits) == given


@given(st.integers(0, 100), LIMITS)
def test_shares_give_all_that_limits_allow_and_differ_by_one_below_them(
    total: int, limits: list[int]
) -> None:
    found = split_evenly(total, limits)

    assert sum(found) == min(total, sum(limits))
    assert all(share <= limit for share, limit in zip(found, limits, strict=True))
    open_ones = [share for share, limit in zip(found, limits, strict=True) if share < limit]
    assert not open_ones or max(found) - min(open_ones) <= 1


@given(st.integers(0, 40), LIMITS, st.data())
def test_moves_end_in_even_shares_for_any_pool_and_lose_no_robot(
    total: int, limits: list[int], data: st.DataObject
) -> None:
    pools = {f"p{number}": limit for number, limit in enumerate(limits)}
    held: dict[str, list[str]] = {pool: [] for pool in pools}
    robots = [f"r{number}" for number in range(total)]

    # Pools start one after another, and each requests again at the end.
    joined: dict[str, int] = {}
    for pool in [*pools, *data.draw(st.permutations(list(pools)))]:
        joined[pool] = pools[pool]
        taken = {name for names in held.values() for name in names}
        moved = find_robots_to_move(pool, joined, held, [one for one in robots if one not in taken])
        for names in held.values():
            names[:] = [name for name in names if name not in moved]
        held[pool] += moved

    sizes = [len(names) for names in held.values()]
    assert tuple(sizes) == split_evenly(total, limits)
    assert len({name for names in held.values() for name in names}) == sum(sizes)


def test_moves_take_free_robots_before_those_of_others() -> None:
    moved = find_robots_to_move("b", {"a": MANY, "b": MANY}, {"a": ["r0", "r1", "r2"]}, ["r3"])

    assert moved == ("r3", "r2")


def test_no_robot_moves_when_shares_are_even() -> None:
    held = {"a": ["r0", "r1"], "b": ["r2"]}

    assert find_robots_to_move("a", {"a": MANY, "b": MANY}, held, []) == ()
    assert find_robots_to_move("b", {"a": MANY, "b": MANY}, held, []) == ()


CRATE = a_box()


def share(parts: ServerParts, pool: str, limit: int = 0) -> agent_messages.ClaimShareResponse:
    parts.agents.alive.add(pool)
    response = handle_request(parts, agent_messages.ClaimShareRequest(pool, limit))
    assert isinstance(response, agent_messages.ClaimShareResponse)
    return response


def driven_by(parts: ServerParts, pool: str) -> list[str]:
    return [name for name, _ in parts.world.claims.list_claims(pool)]


def test_first_pool_gets_all_robots_without_a_claim() -> None:
    parts = make_parts(a_world("r0", "r1", "r2"))
    parts.agents.alive.add("a")
    handle_request(parts, agent_messages.ClaimEntityRequest("a", ("r1",)))

    response = share(parts, "p")

    assert [grant.entity for grant in response.grants] == ["r0", "r2"]
    assert driven_by(parts, "a") == ["r1"]


def test_agent_that_names_robots_takes_them_from_a_pool_and_not_from_another_that_does() -> None:
    parts = make_parts(a_world("r0", "r1"))
    share(parts, "p")
    parts.agents.alive.update(("a", "b"))

    handle_request(parts, agent_messages.ClaimEntityRequest("a", ("r1",)))

    assert (driven_by(parts, "a"), driven_by(parts, "p")) == (["r1"], ["r0"])
    assert share(parts, "p").grants == ()
    with pytest.raises(RequestRefused, match="r1"):
        handle_request(parts, agent_messages.ClaimEntityRequest("b", ("r1",)))


def test_second_pool_takes_its_half_from_the_first() -> None:
    parts = make_parts(a_world("r0", "r1", "r2", "r3"))
    share(parts, "p")

    response = share(parts, "q")

    assert [grant.entity for grant in response.grants] == ["r2", "r3"]
    assert driven_by(parts, "p") == ["r0", "r1"]
    assert share(parts, "p").grants == ()


class CountedEntities(EntityStore):
    """Counts how often all entities are listed."""

    listed = 0

    def __iter__(self) -> Iterator[Entity]:
        type(self).listed += 1
        return super().__iter__()


def test_share_is_not_searched_again_while_nothing_has_changed() -> None:
    parts = make_parts(a_world("r0", "r1", "r2"))
    parts.world.entities.__class__ = CountedEntities
    share(parts, "p")
    share(parts, "p")
    CountedEntities.listed = 0

    responses = [share(parts, "p") for _ in range(3)]

    assert [response.grants for response in responses] == [(), (), ()]
    assert CountedEntities.listed == 0


@pytest.mark.parametrize("change", ["spawn", "release", "silent", "end", "limit"])
def test_share_is_searched_again_after_a_change(change: str) -> None:
    parts = make_parts(a_world("r0", "r1", "r2"))
    share(parts, "q")
    share(parts, "p", limit=2)
    assert share(parts, "p", limit=2).grants == share(parts, "q").grants == ()

    match change:
        case "spawn":
            parts.world.spawn(a_spawn("r3"))
        case "release":
            parts.world.claims.drop(driven_by(parts, "p")[0])
        case "silent":
            parts.agents.graces.pop("q")
            parts.world.claims.note_silent("q")
        case "end":
            parts.agents.pool_limits.pop("q")
            parts.world.release("q")
        case "limit":
            share(parts, "q", limit=1)

    assert len(share(parts, "p", limit=2).grants) == 1


def test_claims_and_models_come_with_the_environment_of_the_loaded_world() -> None:
    parts = make_parts(a_world("r0", "r1"))
    place = SphericalCoordinates(48.0, 11.0)
    parts.current_world.seed = 9
    parts.current_world.model = WorldModel(
        "field", gravity=(0.0, 0.0, -1.6), spherical_coordinates=place
    )
    expected = Environment(
        9,
        (0.0, 0.0, -1.6),
        EARTH_MAGNETIC_FIELD,
        place,
        parts.world.clock.step_ns,
        CONTROL_STEPS,
        has_ground=False,
    )

    shared = share(parts, "p", 1)
    named = handle_request(parts, agent_messages.ClaimEntityRequest("p", ("r1",)))
    listed = handle_request(parts, GetModelsRequest())

    assert isinstance(named, agent_messages.ClaimEntityResponse)
    assert isinstance(listed, GetModelsResponse)
    assert shared.environment == named.environment == listed.environment == expected


def test_share_contains_each_model_and_text_once() -> None:
    parts = make_parts(a_world("r0", "r1", "r2"))

    response = share(parts, "p")

    assert len(response.grants) == 3
    assert len(response.models) == len(response.robot_descriptions) == 1
    assert [one.model for one in agent_messages.expand_grants(response)] == [
        entity.model for entity in parts.world.entities
    ]


def test_share_keeps_to_the_limit_of_a_pool() -> None:
    parts = make_parts(a_world("r0", "r1", "r2"))

    assert len(share(parts, "p", limit=1).grants) == 1
    assert len(share(parts, "q").grants) == 2


def test_share_excludes_entities_without_a_drive() -> None:
    parts = make_parts(a_world("r0"))
    parts.world.spawn(a_spawn("crate", model=CRATE, base=on_ground(5.0)))

    assert [grant.entity for grant in share(parts, "p").grants] == ["r0"]


@pytest.mark.parametrize(
    "published",
    [
        {"sensors": (Sensor("imu", "imu", "base", "base", settings=ImuSensor()),)},
        {"joint_state": JointStatePublisher(joints=())},
        {"ground_truths": (GroundTruth("base"),)},
    ],
    ids=["sensor", "joint states", "ground truth"],
)
def test_share_has_entities_that_publish_without_a_drive(published: dict[str, Any]) -> None:
    parts = make_parts(a_world())
    pole = msgspec.structs.replace(a_box(), **published)
    parts.world.spawn(a_spawn("pole", model=pole, base=on_ground(5.0)))

    assert share(parts, "p").is_more is False
    assert driven_by(parts, "p") == ["pole"]


def test_share_excludes_frozen_entities() -> None:
    parts = make_parts(a_world("r0", "r1"))
    parts.world.divergence_guard.freeze(parts.world.entities.find("r1"))

    assert [grant.entity for grant in share(parts, "p").grants] == ["r0"]


def test_share_is_cut_where_texts_would_not_fit_in_a_reply(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = make_parts(a_world("r0", "r1"))
    monkeypatch.setattr(claim_services, "MAX_SHARE_TEXT", -1)

    first, second = share(parts, "p"), share(parts, "p")

    assert [len(first.grants), first.is_more] == [1, True]
    assert [len(second.grants), second.is_more] == [1, False]


def test_robots_of_a_lost_pool_go_to_the_other() -> None:
    parts = make_parts(a_world("r0", "r1"))
    share(parts, "p")
    share(parts, "q")

    parts.world.release("p")
    parts.agents.pool_limits.pop("p")

    assert [grant.entity for grant in share(parts, "q").grants] == ["r0"]


def test_robots_of_a_silent_pool_go_to_the_other_until_it_calls_again() -> None:
    parts = make_parts(a_world("r0", "r1"))
    share(parts, "p")
    share(parts, "q")

    parts.agents.graces.pop("p")
    parts.world.stop_silent("p")

    assert [grant.entity for grant in share(parts, "q").grants] == ["r0"]
    assert [grant.entity for grant in share(parts, "p").grants] == ["r0"]


@pytest.mark.parametrize(
    ("simulated_ns", "wall_ns", "moved"),
    [(0, 0, []), (START_NS, 0, []), (0, START_NS, []), (START_NS, START_NS, ["r0"])],
)
def test_silent_pool_that_has_just_got_robots_keeps_them_for_a_time(
    simulated_ns: int, wall_ns: int, moved: list[str]
) -> None:
    parts = make_parts(a_world("r0", "r1"))
    share(parts, "p")
    share(parts, "q")

    parts.world.stop_silent("p")
    began_ns = parts.world.clock.time_ns - simulated_ns, parts.pacing.now_ns() - wall_ns
    parts.agents.graces["p"] = ShareGrace(*began_ns, parts.agents.graces["p"].lasts_ns)

    assert [grant.entity for grant in share(parts, "q").grants] == moved


def test_robots_of_a_pool_that_started_before_a_reset_are_not_kept() -> None:
    parts = make_parts(a_world("r0", "r1"))
    share(parts, "p")
    share(parts, "q")
    now_ns = parts.world.clock.time_ns + 1, parts.pacing.now_ns()
    parts.agents.graces["p"] = ShareGrace(*now_ns, START_NS)

    parts.world.stop_silent("p")

    assert [grant.entity for grant in share(parts, "q").grants] == ["r0"]


def test_pool_without_a_token_is_refused() -> None:
    with pytest.raises(IncorrectState, match="'p'"):
        handle_request(make_parts(a_world("r0")), agent_messages.ClaimShareRequest("p"))


def claim_by(protocol: int, *, is_pool: bool) -> ServerParts:
    parts = make_parts(a_world("r0"))
    parts.agents.alive.add("a")
    named = agent_messages.ClaimEntityRequest("a", ("r0",), protocol=protocol)
    pooled = agent_messages.ClaimShareRequest("a", protocol=protocol)
    handle_request(parts, pooled if is_pool else named)
    return parts


@pytest.mark.parametrize("is_pool", [True, False])
@pytest.mark.parametrize("before", [0, 1])
def test_agents_of_this_protocol_and_of_the_one_before_drive(
    before: int, monkeypatch: pytest.MonkeyPatch, *, is_pool: bool
) -> None:
    monkeypatch.setattr(claim_services, "PROTOCOL", 5)

    assert driven_by(claim_by(5 - before, is_pool=is_pool), "a") == ["r0"]


@pytest.mark.parametrize("is_pool", [True, False])
@pytest.mark.parametrize("difference", [-2, 1])
def test_agents_of_other_protocols_are_refused(
    difference: int, monkeypatch: pytest.MonkeyPatch, *, is_pool: bool
) -> None:
    monkeypatch.setattr(claim_services, "PROTOCOL", 5)

    with pytest.raises(WrongProtocol) as caught:
        claim_by(5 + difference, is_pool=is_pool)

    assert str(caught.value).startswith("agent.protocol: ")
    assert caught.value.code == ResultCode.FEATURE_UNSUPPORTED


@pytest.mark.parametrize(
    "kind", [agent_messages.ClaimEntityRequest, agent_messages.ClaimShareRequest]
)
def test_agents_that_say_no_protocol_know_the_first(kind: type[msgspec.Struct]) -> None:
    assert msgspec.to_builtins(msgspec.json.decode(b'{"agent": "a"}', type=kind))["protocol"] == 1


def test_pool_with_a_bad_name_is_refused() -> None:
    with pytest.raises(RequestRefused, match="'p q'"):
        handle_request(make_parts(a_world("r0")), agent_messages.ClaimShareRequest("p q"))


def test_claims_of_a_response_share_models_and_refuse_missing_models() -> None:
    response = share(make_parts(a_world("r0", "r1")), "p")
    one, other = agent_messages.expand_grants(response)

    assert one.model is other.model
    with pytest.raises(MalformedPayload):
        agent_messages.expand_grants(msgspec.structs.replace(response, models=()))


def test_claims_name_offered_files_by_url() -> None:
    model, text = a_cart(), '<robot><mesh filename="a.stl"/></robot>'
    parts = make_parts(a_world())
    for name in ("r1", "r2"):
        parts.world.spawn(ValidatedSpawn(name, "", model, on_ground(), text))
    files = (AssetRef("a.stl", "0" * 64),)
    parts.descriptions.provider.remember(
        ParseKey(text, "fixed", allow_missing=False, assets=files), model
    )
    parts.agents.alive.add("a")
    request = agent_messages.ClaimEntityRequest("a", ("r1", "r2"))

    parts.descriptions.published = PublishedFiles("http://h:1/")
    response = handle_request(parts, request)

    assert isinstance(response, agent_messages.ClaimEntityResponse)
    (published,) = response.robot_descriptions
    assert published.startswith('<robot><mesh filename="http://h:1/')
    assert published.endswith('/a.stl"/></robot>')
