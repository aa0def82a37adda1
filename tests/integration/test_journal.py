"""Journals of real servers: killed, terminated, out of disk, and inspected."""

import json
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

import pytest
import trimesh

from tests.integration.journals import kill_hard, last_line, serving_with_journal
from tests.integration.processes import (
    END_S,
    Server,
    eventually,
    free_endpoint,
    run_in_process,
    running_agents,
    serving,
    wait_for_agents,
    zensim,
)
from tests.integration.robots import robot
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose
from zensim.proto.messages.world_messages import GetCurrentWorldRequest, LoadWorldRequest
from zensim.proto.service_catalog import GET_CURRENT_WORLD, LOAD_WORLD, SPAWN_ENTITY
from zensim.sim_server.journal.server_journal import ASSETS
from zensim.sim_server.journal.sqlite_store import DATABASE

SMALL_BYTES = 1 << 20
TRACED = "fsync,fdatasync,pwrite64,sendto,sendmsg,write,writev"


def an_order(name: str) -> SpawnEntityOrder:
    return SpawnEntityOrder(name, entity_resource=Resource("box_bot"))


def test_copy_without_its_log_is_used_only_when_the_loss_is_accepted(tmp_path: Path) -> None:
    used, copy = tmp_path / "used", tmp_path / "copy"
    with serving_with_journal(used, free_endpoint()) as server:
        server.client.spawn(an_order("r0"))
        kill_hard(server)
    leave_log = shutil.ignore_patterns(f"{DATABASE}-*")
    shutil.copytree(used, copy, ignore=leave_log)

    for action in ("show", "verify", "export"):
        assert run_in_process("journal", action, str(copy)).returncode == 1
    assert run_in_process("journal", "backup", str(copy), str(tmp_path / "b")).returncode == 1
    refused = zensim("serve", "--listen", free_endpoint(), "--journal", str(copy))
    accepted = run_in_process("journal", "verify", str(copy), "--accept-loss")

    assert (refused.returncode, "--accept-loss" in refused.stderr) == (1, True)
    assert accepted.returncode == 0
    with serving_with_journal(copy, free_endpoint()) as server:
        assert server.client.entities() == ()


def test_killed_server_is_restored(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with serving_with_journal(tmp_path, endpoint) as server:
        for name in ("r0", "r1", "r2"):
            server.client.spawn(an_order(name))
        server.client.delete("r1")
        place = EntityState(pose=Pose(Point(3.0, 4.0, 0.06)))
        server.client.set_entity_state("r2", place)
        server.client.set_simulation_state(State.PAUSED)
        before = server.client.info()
        kill_hard(server)

    with serving_with_journal(tmp_path, endpoint) as server:
        after = server.client.info()
        found = server.client.entity_state("r2").pose.position

        assert server.client.entities() == ("r0", "r2")
        assert (found.x, found.y) == pytest.approx((3.0, 4.0), abs=0.01)
        assert server.client.simulation_state() == State.PAUSED
        assert (after.epoch, after.state) == (before.epoch + 1, "paused")
        assert 0.0 <= before.sim_time_s - after.sim_time_s <= 0.5


def test_agent_resumes_driving_after_the_server_was_killed(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with serving_with_journal(tmp_path, endpoint) as server:
        server.client.spawn(an_order("r0"))
        with running_agents(server, "r0"):
            kill_hard(server)
            with serving_with_journal(tmp_path, endpoint) as again:
                wait_for_agents(again, ["r0"])
                driver = robot(again.bus, "r0")

                def is_moving() -> bool:
                    driver.command(0.3)
                    return again.client.entity_state("r0").twist.linear.x > 0.05

                eventually(is_moving, 20.0, "moving again")


def test_retry_after_a_restart_gets_the_cached_response_and_no_second_robot(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    order = SpawnEntityOrder("r0", allow_renaming=True, entity_resource=Resource("box_bot"))

    with serving_with_journal(tmp_path, endpoint) as server:
        first = server.bus.call(SPAWN_ENTITY, order, world="default", request_id="once")
        kill_hard(server)
    with serving_with_journal(tmp_path, endpoint) as server:
        again = server.bus.call(SPAWN_ENTITY, order, world="default", request_id="once")

        assert again == first
        assert server.client.entities() == ("r0",)


def test_terminated_server_closes_its_journal(tmp_path: Path) -> None:
    with serving_with_journal(tmp_path, free_endpoint()) as server:
        server.client.spawn(an_order("r0"))
        server.process.send_signal(signal.SIGTERM)

        assert server.process.wait(END_S) == 0
    assert not (tmp_path / f"{DATABASE}-wal").exists()
    verified = run_in_process("journal", "verify", str(tmp_path))
    assert (verified.returncode, verified.stdout.count("\n")) == (0, 1)


def test_journal_is_shown_and_exported_while_its_server_runs(tmp_path: Path) -> None:
    with serving_with_journal(tmp_path, free_endpoint()) as server:
        server.zensim("spawn", "box_bot", "--name", "r0", "-x", "2")

        shown = run_in_process("journal", "show", str(tmp_path))
        exported = json.loads(run_in_process("journal", "export", str(tmp_path)).stdout)

        assert "r0  ns=r0  model=box_bot  at 2.000 0.000 0.060" in shown.stdout
        assert exported["entities"][0]["name"] == "r0"
        description = tmp_path / "r0.urdf"
        description.write_text(exported["descriptions"]["r0"])
        assert server.zensim("spawn", str(description), "--name", "r1").returncode == 0


def test_second_server_is_refused_in_one_line(tmp_path: Path) -> None:
    with serving_with_journal(tmp_path, free_endpoint()):
        second = zensim("serve", "--listen", free_endpoint(), "--journal", str(tmp_path))

        assert second.returncode == 1
        assert last_line(second).endswith(
            "is used by another server; stop it, or use another folder"
        )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--step-hz", "100"), "counts steps of 240 Hz, not 100; leave --step-hz out"),
        (("--world-name", "other"), "is the journal of world 'default'; use --world-name default"),
    ],
)
def test_journal_of_another_world_is_refused(
    tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    with serving_with_journal(tmp_path, free_endpoint()):
        pass

    done = zensim("serve", "--listen", free_endpoint(), "--journal", str(tmp_path), *arguments)

    assert done.returncode == 1
    assert said in last_line(done)


def test_damaged_journal_is_refused_in_one_line(tmp_path: Path) -> None:
    with serving_with_journal(tmp_path, free_endpoint()) as server:
        server.client.spawn(an_order("r0"))
        server.process.send_signal(signal.SIGTERM)
        server.process.wait(END_S)
    data = bytearray((tmp_path / DATABASE).read_bytes())
    data[data.index(b"box_bot")] ^= 1
    (tmp_path / DATABASE).write_bytes(data)

    served = zensim("serve", "--listen", free_endpoint(), "--journal", str(tmp_path))
    verified = run_in_process("journal", "verify", str(tmp_path))

    for done in (served, verified):
        assert done.returncode == 1
        assert "is damaged: row " in last_line(done)
        assert done.stderr.count("\n") == 1


def test_reply_is_sent_after_fsync(tmp_path: Path) -> None:
    log, names = tmp_path / "calls", [f"marked{i}" for i in range(5)]
    # -D: the server stays a child of this process, and strace ends with it.
    tracing = ("strace", "-D", "-f", "-qq", "-yy", "-s", "65536", "-e", f"trace={TRACED}")
    with serving_with_journal(
        tmp_path / "j", free_endpoint(), prefix=(*tracing, "-o", str(log))
    ) as server:
        for name in names:
            server.bus.call(SPAWN_ENTITY, an_order(name), world="default", timeout_s=20.0)
    lines = log.read_text(errors="replace").splitlines()
    for name in names:
        written = first(lines, 0, f"{DATABASE}-wal", "pwrite", name)
        synced = first(lines, written, f"{DATABASE}-wal", "sync(")
        replied = first(lines, 0, "TCP:", name)
        assert written < synced < replied


def first(lines: list[str], start: int, *texts: str) -> int:
    """Find the first line at or after a start that contains all texts."""
    return next(i for i in range(start, len(lines)) if all(text in lines[i] for text in texts))


def test_loaded_world_and_meshes_are_restored_after_a_kill(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with serving_with_journal(tmp_path / "j", endpoint) as server:
        server.bus.call(
            LOAD_WORLD, LoadWorldRequest(Resource("walls")), world="default", timeout_s=20.0
        )
        spawned = server.zensim(
            "spawn", str(write_mesh_robot(tmp_path)), "--name", "m0", "-z", "0.5"
        )
        assert spawned.returncode == 0, spawned.stderr
        before = server.client.models()
        kill_hard(server)

    with serving_with_journal(tmp_path / "j", endpoint) as server:
        current = server.bus.call(GET_CURRENT_WORLD, GetCurrentWorldRequest(), world="default")
        after = server.client.models()

        assert current.world.world_resource.uri == "walls"
        assert [one.entity for one in after.entities] == [one.entity for one in before.entities]
        assert set(after.models) == set(before.models)
        assert server.client.entity_state("m0").pose.position.z == pytest.approx(0.5, abs=0.01)


def write_mesh_robot(folder: Path) -> Path:
    """Write a robot with a cube mesh of 1 m on the ground."""
    trimesh.creation.box((1.0, 1.0, 1.0)).export(folder / "cube.stl")
    mesh = '<geometry><mesh filename="cube.stl"/></geometry>'
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    robot = folder / "cube.urdf"
    robot.write_text(
        f'<robot name="cube"><link name="base"><inertial><mass value="1"/>{inertia}</inertial>'
        f'<collision><origin xyz="0 0 0"/>{mesh}</collision></link></robot>'
    )
    return robot


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """Mount a small file system."""
    folder.mkdir()
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={SMALL_BYTES}", "tmpfs", str(folder)], check=True
    )
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.root
def test_full_disk_refuses_spawns_while_robots_keep_driving(tmp_path: Path) -> None:
    with (
        small_disk(tmp_path / "disk") as disk,
        serving_with_journal(disk / "j", free_endpoint()) as server,
    ):
        server.client.spawn(an_order("r0"))
        ballast = disk / "ballast"
        fill_up(ballast)
        refused = spawned_until_refused(server)
        before = server.steps()

        assert "journal" in refused.message
        assert refused.code == ResultCode.OPERATION_FAILED
        saved = server.client.entities()
        eventually(lambda: server.steps() > before + 240, 20.0, "stepping")
        ballast.unlink()
        server.client.spawn(an_order("after"))
        assert server.client.entities() == (*saved, "after")
        kill_hard(server)
        with serving_with_journal(disk / "j", free_endpoint()) as again:
            assert again.client.entities() == (*saved, "after")


def remount(folder: Path, mode: str) -> None:
    """Make a file system read-only (`ro`) or writable (`rw`)."""
    subprocess.run(["mount", "-o", f"remount,{mode}", str(folder)], check=True)


def refusal_of(server: Server, act: Callable[[], object]) -> str:
    """Return how the message of a refusal begins; the server must go on stepping."""
    with pytest.raises(ServiceError) as caught:
        act()
    before = server.steps()
    eventually(lambda: server.steps() > before, 20.0, "stepping")
    return caught.value.message.partition(": ")[0]


def put(server: Server, data: bytes) -> None:
    server.client.put_asset(sha256(data).hexdigest(), offset=0, total=len(data), data=data)


@pytest.mark.root
def test_full_disk_of_temporary_files_refuses_uploads_only(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as disk, serving(prefix=("env", f"TMPDIR={disk}")) as server:
        ballast = disk / "ballast"
        fill_up(ballast)

        slug = refusal_of(server, lambda: put(server, bytes(100_000)))
        server.client.spawn(an_order("r0"))
        ballast.unlink()
        put(server, bytes(100_000))

        assert slug == "bundle.disk"
        assert server.client.entities() == ("r0",)


@pytest.mark.root
def test_read_only_disk_of_temporary_files_refuses_uploads_until_it_is_writable(
    tmp_path: Path,
) -> None:
    with small_disk(tmp_path / "disk") as disk, serving(prefix=("env", f"TMPDIR={disk}")) as server:
        remount(disk, "ro")

        slug = refusal_of(server, lambda: put(server, bytes(1000)))
        server.client.spawn(an_order("r0"))
        remount(disk, "rw")
        put(server, bytes(1000))

        assert slug == "bundle.disk"
        assert server.client.entities() == ("r0",)


@pytest.mark.root
def test_journal_on_a_read_only_disk_refuses_a_start_in_one_line_and_is_shown(
    tmp_path: Path,
) -> None:
    endpoint = free_endpoint()
    with small_disk(tmp_path / "disk") as disk:
        with serving_with_journal(disk / "j", endpoint) as server:
            server.client.spawn(an_order("r0"))
            kill_hard(server)
        remount(disk, "ro")

        refused = zensim("serve", "--listen", endpoint, "--journal", str(disk / "j"))
        shown = run_in_process("journal", "show", str(disk / "j"))
        remount(disk, "rw")

        assert refused.returncode == 1
        assert str(disk / "j") in last_line(refused)
        assert (shown.returncode, "r0" in shown.stdout) == (0, True)
        with serving_with_journal(disk / "j", endpoint) as again:
            assert again.client.entities() == ("r0",)


def fill_up(ballast: Path) -> None:
    with ballast.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))


def spawned_until_refused(server: Server) -> ServiceError:
    """Spawn until the disk is full."""
    with pytest.raises(ServiceError) as caught:
        spawn_many(server, 200)
    return caught.value


def spawn_many(server: Server, count: int) -> None:
    for i in range(count):
        server.client.spawn(an_order(f"extra{i}"))


def test_server_goes_on_when_its_folder_of_files_is_removed(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    robot_file = str(write_mesh_robot(tmp_path))
    with serving_with_journal(tmp_path / "j", endpoint) as server:
        first = server.zensim("spawn", robot_file, "--name", "m0", "-z", "0.5")
        shutil.rmtree(tmp_path / "j" / ASSETS)

        second = server.zensim("spawn", robot_file, "--name", "m1", "-x", "3", "-z", "0.5")

        assert (first.returncode, second.returncode) == (0, 0), second.stderr
        assert set(server.client.entities()) == {"m0", "m1"}
        kill_hard(server)
    with serving_with_journal(tmp_path / "j", endpoint) as again:
        assert set(again.client.entities()) == {"m0", "m1"}
