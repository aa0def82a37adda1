"""The run of a world to a time, of which there is one."""

import pytest

from zensim.spawner.page.world_run import RunActive, WorldRun

ANN, BOB = 1, 2


@pytest.mark.parametrize("visitor", [ANN, BOB])
def test_a_second_run_is_refused_until_the_first_is_over(visitor: int) -> None:
    run = WorldRun()
    number = run.begin(ANN, 10.0)

    with pytest.raises(RunActive):
        run.begin(visitor, 20.0)
    assert (run.visitor, run.goal_s) == (ANN, 10.0)
    run.end(number)

    run.begin(visitor, 20.0)
    assert (run.visitor, run.goal_s) == (visitor, 20.0)


def test_the_end_of_a_canceled_run_does_not_end_the_next_one() -> None:
    run = WorldRun()
    first = run.begin(ANN, 10.0)
    run.cancel()
    run.begin(BOB, 20.0)

    run.end(first)

    assert (run.visitor, run.goal_s) == (BOB, 20.0)
