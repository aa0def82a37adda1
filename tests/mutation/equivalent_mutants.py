"""Mutants of the sample that change nothing that could be noticed, by name, and why."""

EQUIVALENTS = {
    "sim_server/physics/mujoco/slot_state.py: MAX_EFFORT = 1e12: 1e12 -> (1e12 + 1)": (
        "a brake of 1e12 N m holds whatever one of 1e12 + 1 N m does"
    ),
    "sim_server/description/driving_notes.py: "
    "if is_fast and is_slow and abs(speed - rate) < SAME_RATIO:: < -> <=": (
        "predicted ratios do not differ by exactly SAME_RATIO"
    ),
    "sim_server/description/driving_notes.py: "
    "if abs(drift) > DRIFT_RAD_S and abs(speed) > STANDS_SHARE:: > -> >= #2": (
        "no predicted ratio is exactly STANDS_SHARE"
    ),
    "sim_server/physics/bullet/pybullet_engine.py: "
    "ORIGIN_STATE: FloatArray = np.array([0.0] * 6 + [1.0] + [0.0] * 6): 1.0 -> (1.0 + 1)": (
        "Bullet normalizes the rotation"
    ),
    "sim_server/physics/bullet/pybullet_engine.py: self._origin.changes += 1: 1 -> (1 + 1)": (
        "counts of changes are compared for equality only"
    ),
    "sim_server/description/strict_xml.py: no_network=True,: True -> False": (
        "nothing is loaded: there are no DTDs and no entities"
    ),
    "sim_server/physics/kinematic/kinematic_robots.py: "
    "self._has_offset_discs = False: False -> True": "it is set before there is a robot",
    "sim_server/description/plugins/joint_controllers.py: model: Model, files: Sequence[str], "
    "report: ParseReport, *, has_free_wheels: bool = False: False -> True": (
        "the only caller gives it"
    ),
    "robot_agent/joint_trajectory.py: @dataclass(frozen=True): True -> False": (
        "nothing assigns to a goal or a state; mypy refuses it"
    ),
    "robot_agent/robot_frames.py: class FrameEdge(msgspec.Struct, frozen=True):: True -> False": (
        "nothing assigns to an edge; mypy refuses it"
    ),
}
