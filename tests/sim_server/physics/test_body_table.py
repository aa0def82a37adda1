"""Numbers of bodies."""

from zensim.sim_server.physics.body_table import BodyNumbers


def test_numbers_count_from_zero() -> None:
    numbers = BodyNumbers()

    assert [numbers.take() for _ in range(3)] == [0, 1, 2]


def test_least_free_number_is_taken_first() -> None:
    numbers = BodyNumbers()
    for _ in range(4):
        numbers.take()

    for body in (2, 0):
        numbers.give_back(body)

    assert [numbers.take() for _ in range(3)] == [0, 2, 4]
