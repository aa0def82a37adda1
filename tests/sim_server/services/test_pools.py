"""Claims of pools: shares of the robots that nobody drives by name."""

import msgspec
import pytest

from tests.models import a_box, on_ground
from tests.sim_server.fakes import a_spawn, a_world, handle_request, make_parts
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages import agent_messages
from zensim.sim_server.errors import IncorrectState, RequestRefused
from zensim.sim_server.service_parts import ServerParts
from zensim.sim_server.services import claim_services

CRATE = a_box()


def share(parts: ServerParts, pool: str, limit: int = 0) -> agent_messages.ClaimShareResponse:
    parts.agents.alive.add(pool)
    response = handle_request(parts, agent_messages.ClaimShareRequest(pool, limit))
    assert isinstance(response, agent_messages.ClaimShareResponse)
    return response


def driven_by(parts: ServerParts, pool: str) -> list[str]:
    return [name for name, _ in parts.world.claims.list_claims(pool)]


def test_first_pool_gets_all_robots_that_nobody_drives_by_name() -> None:
    parts = make_parts(a_world("r0", "r1", "r2"))
    parts.agents.alive.add("a")
    handle_request(parts, agent_messages.ClaimEntityRequest("a", ("r1",)))

    response = share(parts, "p")

    assert [grant.entity for grant in response.grants] == ["r0", "r2"]
    assert driven_by(parts, "a") == ["r1"]


def test_second_pool_takes_its_half_from_the_first() -> None:
    parts = make_parts(a_world("r0", "r1", "r2", "r3"))
    share(parts, "p")

    response = share(parts, "q")

    assert [grant.entity for grant in response.grants] == ["r2", "r3"]
    assert driven_by(parts, "p") == ["r0", "r1"]
    assert share(parts, "p").grants == ()


def test_share_says_each_model_and_text_once() -> None:
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


def test_share_leaves_what_has_no_drive() -> None:
    parts = make_parts(a_world("r0"))
    parts.world.spawn(a_spawn("crate", model=CRATE, base=on_ground(5.0)))

    assert [grant.entity for grant in share(parts, "p").grants] == ["r0"]


def test_share_leaves_what_is_frozen() -> None:
    parts = make_parts(a_world("r0", "r1"))
    parts.world.divergence_guard.freeze(parts.world.entities.find("r1"))

    assert [grant.entity for grant in share(parts, "p").grants] == ["r0"]


def test_share_is_cut_where_texts_would_not_fit_in_a_reply(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parts = make_parts(a_world("r0", "r1"))
    monkeypatch.setattr(claim_services, "MAX_SHARE_TEXT", -1)

    first, second = share(parts, "p"), share(parts, "p")

    assert [len(first.grants), first.is_more] == [1, True]
    assert [len(second.grants), second.is_more] == [1, False]


def test_robots_of_a_pool_that_died_go_to_the_other() -> None:
    parts = make_parts(a_world("r0", "r1"))
    share(parts, "p")
    share(parts, "q")

    parts.world.release("p")
    parts.agents.pool_limits.pop("p")

    assert [grant.entity for grant in share(parts, "q").grants] == ["r0"]


def test_pool_without_a_token_is_refused() -> None:
    with pytest.raises(IncorrectState, match="'p'"):
        handle_request(make_parts(a_world("r0")), agent_messages.ClaimShareRequest("p"))


def test_pool_with_a_bad_name_is_refused() -> None:
    with pytest.raises(RequestRefused, match="'p q'"):
        handle_request(make_parts(a_world("r0")), agent_messages.ClaimShareRequest("p q"))


def test_claims_of_a_response_share_models_and_refuse_what_is_not_there() -> None:
    response = share(make_parts(a_world("r0", "r1")), "p")
    one, other = agent_messages.expand_grants(response)

    assert one.model is other.model
    with pytest.raises(MalformedPayload):
        agent_messages.expand_grants(msgspec.structs.replace(response, models=()))
