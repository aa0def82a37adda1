"""Every file of a user is read by `zensim.proto.bounded_files`, which limits its kind and size."""

import ast
from collections.abc import Iterator
from pathlib import Path

import zensim

PROGRAMS = ("proto", "sim_server", "spawner", "robot_agent", "zensim", "deploy")
OF_THE_KERNEL = "files of /proc and /sys"
OF_THE_PACKAGE = "files of the package, as they were installed"
OF_THE_STORE = "files that the asset store of this server wrote, within its limits"
OWN = {
    "proto/bounded_files.py": "the functions themselves",
    "proto/child_process.py": "pipes of child processes",
    "proto/package_versions.py": OF_THE_PACKAGE,
    "proto/process_copies.py": OF_THE_KERNEL,
    "proto/process_limits.py": OF_THE_KERNEL,
    "proto/process_memory.py": OF_THE_KERNEL,
    "proto/schema.py": "files of the source, in development",
    "sim_server/description/builtin_models.py": OF_THE_PACKAGE,
    "sim_server/input_log/input_records.py": OF_THE_KERNEL,
    "sim_server/input_log/log_writer.py": OF_THE_STORE,
    "sim_server/journal/batch_writer.py": "a file that was just copied, to sync it",
    "sim_server/parser_process/asset_store.py": OF_THE_STORE,
    "sim_server/parser_process/mesh_server.py": OF_THE_STORE,
    "sim_server/parser_process/parser_client.py": OF_THE_KERNEL,
    "sim_server/physics/blueprint.py": OF_THE_STORE,
    "sim_server/physics/body_reach.py": OF_THE_STORE,
    "sim_server/physics/bullet/pybullet_engine.py": "a state that Bullet wrote a moment ago",
    "sim_server/physics/cell_worker.py": OF_THE_KERNEL,
    "sim_server/physics/kinematic/planar_vehicle.py": OF_THE_STORE,
    "sim_server/physics/mujoco/convex_pieces.py": OF_THE_STORE,
    "sim_server/security/router_process.py": "the pipe of a child process",
    "spawner/page/edit_panel.py": OF_THE_PACKAGE,
    "spawner/page/page_files.py": OF_THE_PACKAGE,
    "spawner/spawn/description_sources.py": OF_THE_PACKAGE,
    "spawner/teleop/gamepad.py": "the device of a game pad, event by event",
    "spawner/top/local_processes.py": OF_THE_KERNEL,
    "zensim/api/program_keeper.py": "the pipe of a child process",
    "zensim/scenario/run_host.py": OF_THE_KERNEL,
    "zensim/scenario/scenario_schema.py": "a page of the documents, in development",
}
"""Modules that read files by other means, and which."""
READS_IN_PATH = {"read_text", "read_bytes"}


def list_reads(tree: ast.AST) -> Iterator[ast.Call]:
    """List the calls that read a file, or open one to read."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and reads_file(node):
            yield node


def reads_file(call: ast.Call) -> bool:
    if isinstance(call.func, ast.Name):
        return call.func.id == "open" and is_read_mode(call.args[1:2])
    if not isinstance(call.func, ast.Attribute):
        return False
    name, owner = call.func.attr, ast.unparse(call.func.value)
    if name in READS_IN_PATH:
        return True
    if owner == "os":
        is_opened = name == "open" and "O_RDONLY" in ast.unparse(call)
        return is_opened or (name == "fdopen" and is_read_mode(call.args[1:2]))
    is_path = owner.rpartition(".")[2].strip("()") in {"path", "file", "target", "source"}
    return name == "open" and is_path and is_read_mode(call.args[:1])


def is_read_mode(given: list[ast.expr]) -> bool:
    """Whether the mode of `open` reads; it is the default."""
    mode = given[0].value if given and isinstance(given[0], ast.Constant) else "r"
    return isinstance(mode, str) and not set(mode) & set("wax")


def test_user_files_are_read_in_one_place() -> None:
    root = Path(next(iter(zensim.__path__))).parent
    paths = [path for name in PROGRAMS for path in sorted((root / name).rglob("*.py"))]

    found = {
        path.relative_to(root).as_posix(): [ast.unparse(one) for one in calls]
        for path in paths
        if (calls := list(list_reads(ast.parse(path.read_text(encoding="utf-8")))))
    }

    assert {name: found[name] for name in found.keys() - OWN.keys()} == {}
    assert OWN.keys() - found.keys() == set()


def test_each_way_to_read_a_file_is_found() -> None:
    ways = """
open(path)
open(path, "rb")
path.read_text()
(folder / name).read_bytes()
path.open()
self.index.path.open("rb")
os.open(path, os.O_RDONLY | os.O_CLOEXEC)
os.fdopen(descriptor, "rb")
"""
    others = """
path.open("w")
open(path, "xb")
os.open(path, os.O_WRONLY)
webbrowser.open(url)
self.open()
"""
    assert len(list(list_reads(ast.parse(ways)))) == len(ways.split("\n")) - 2
    assert list(list_reads(ast.parse(others))) == []
