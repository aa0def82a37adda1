from zensim.sim_server.pacing.stepping_lease import SteppingLease


def a_lease(*alive: str) -> SteppingLease[str]:
    return SteppingLease(set(alive))


def test_client_with_a_token_becomes_the_holder() -> None:
    lease = a_lease("c1", "c2")

    lease.take("c1", "playing")
    lease.take("c2", "paused")

    assert (lease.find_other("c1"), lease.find_other("c2")) == ("", "c1")


def test_client_without_a_token_does_not_become_the_holder() -> None:
    lease = a_lease()

    lease.take("c1", "playing")

    assert not lease.holder


def test_end_of_the_holder_returns_the_mode_that_it_found() -> None:
    lease = a_lease("c1")
    lease.take("c1", "playing")
    lease.take("c1", "paused")

    assert lease.end("c1") == "playing"
    assert not lease.find_other("c2")


def test_end_of_another_client_keeps_the_lease() -> None:
    lease = a_lease("c1", "c2")
    lease.take("c1", "playing")

    assert lease.end("c2") is None
    assert lease.holder == "c1"


def test_mode_to_return_to_is_the_revised_one() -> None:
    lease = a_lease("c1")
    lease.take("c1", "paused")

    lease.revise(lambda mode: f"not {mode}")

    assert lease.end("c1") == "not paused"


def test_nothing_is_revised_without_a_holder() -> None:
    lease = a_lease("c1")

    lease.revise(lambda mode: f"not {mode}")
    lease.take("c1", "paused")

    assert lease.end("c1") == "paused"
