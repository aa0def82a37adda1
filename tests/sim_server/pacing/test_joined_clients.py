from zensim.proto.settings.lockstep_settings import LockstepSettings
from zensim.sim_server.pacing.joined_clients import JoinedClients, JoinedState
from zensim.sim_server.pacing.lockstep import Lockstep

START = JoinedState(0, 0)
MS = 1_000_000


def at(step: int) -> JoinedState:
    return JoinedState(0, step, is_awaited=True)


def test_client_is_woken_at_its_steps_only_and_awaited_then() -> None:
    lockstep = Lockstep()
    clients = JoinedClients(lockstep)
    joined = clients.finish("c1", 6, START)

    clients.wake(at(3), 0)
    assert (joined.wakes, lockstep.is_waiting) == (0, False)
    clients.wake(at(6), 0)

    assert joined.wakes == 1
    assert lockstep.awaited == ("c1",)


def test_client_that_has_finished_its_step_is_not_awaited() -> None:
    lockstep = Lockstep()
    clients = JoinedClients(lockstep)
    clients.finish("c1", 3, START)
    clients.wake(at(3), 0)

    clients.finish("c1", 3, JoinedState(0, 3))

    assert not lockstep.is_waiting


def test_nobody_is_awaited_while_the_world_awaits_no_agents() -> None:
    lockstep = Lockstep()
    clients = JoinedClients(lockstep)
    joined = clients.finish("c1", 3, START)

    clients.wake(JoinedState(0, 3, is_awaited=False), 0)

    assert joined.wakes == 1
    assert not lockstep.is_waiting


def test_client_that_is_late_is_not_awaited_until_it_replies() -> None:
    lockstep = Lockstep(LockstepSettings(lockstep=True, lockstep_timeout=0.01))
    clients = JoinedClients(lockstep)
    clients.finish("c1", 3, START)
    clients.wake(at(3), 0)
    assert lockstep.find_late(11 * MS) == ("c1",)

    assert clients.wake(at(6), 12 * MS) == ("c1",)
    clients.finish("c1", 3, JoinedState(0, 3))
    assert clients.wake(at(9), 13 * MS) == ()

    assert lockstep.awaited == ("c1",)


def test_client_that_is_gone_is_not_awaited() -> None:
    lockstep = Lockstep()
    clients = JoinedClients(lockstep)
    joined = clients.finish("c1", 3, START)
    clients.wake(at(3), 0)

    clients.end("c1")

    assert joined.is_gone
    assert "c1" not in clients
    assert not lockstep.is_waiting
