"""Which robots of a pool are driven together."""

import msgspec

from tests.robot_agent.models import DRIVE, a_claim, two_wheeler
from zensim.robot_agent.pool.group_key import GroupKeys, make_group_key
from zensim.robot_agent.topic_remapping import find_topic_keys


def test_equal_robots_have_one_group_key_whether_they_share_a_model_or_not() -> None:
    keys, shared = GroupKeys(), two_wheeler()
    claims = [a_claim(1, "r1", shared), a_claim(2, "r2", shared), a_claim(3, "r3", two_wheeler())]

    found = [keys.find(one, find_topic_keys(one)) for one in claims]

    assert found[0] is found[1] is found[2]
    assert found[0] == make_group_key(claims[0], find_topic_keys(claims[0]))


def test_robots_of_one_model_with_other_environments_or_patterns_have_other_keys() -> None:
    keys, model = GroupKeys(), two_wheeler()
    claims = [
        a_claim(1, "r1", model),
        a_claim(2, "r2", model, namespace="fleet/r2"),
        msgspec.structs.replace(
            a_claim(3, "r3", model),
            environment=msgspec.structs.replace(a_claim().environment, seed=7),
        ),
    ]

    found = [keys.find(one, find_topic_keys(one)) for one in claims]

    assert found == [make_group_key(one, find_topic_keys(one)) for one in claims]
    assert len(set(found)) == len(claims)


def test_group_keys_that_are_kept_stay_the_same_objects() -> None:
    keys = GroupKeys()
    first, other = (
        a_claim(),
        a_claim(model=two_wheeler(msgspec.structs.replace(DRIVE, update_rate_hz=7.0))),
    )
    kept = keys.find(first, find_topic_keys(first))
    lost = keys.find(other, find_topic_keys(other))

    keys.keep([kept])

    assert keys.find(first, find_topic_keys(first)) is kept
    assert keys.find(other, find_topic_keys(other)) is not lost
