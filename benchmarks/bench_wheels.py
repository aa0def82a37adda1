"""Accuracy on wheels

Own robots that span what public ones have: mass ratios of 1 to 1000, wheels of 1 cm to 30 cm, 0.1
to 500 kg, casters of each kind, suspensions, skid steering on up to eight wheels, friction
directions, and every drive. Each runs in a world of its own with the product's engine and drive
controller, in lockstep at 240 Hz: 2 s at rest, 4 s at 0.2 m/s, 1 s stop, 4 s at 0.5 rad/s
(steered drives: 0.2 m/s at 0.3 rad of steering). The last 2 s of each drive count.

*Predicted* is the steady motion that Coulomb friction allows ([accuracy](accuracy.md)). *Off* is
the greatest deviation from it: of speed and turn relative to the prediction, of the turn while it
drives straight relative to 0.5 rad/s. A sample is a robot.
"""

from collections.abc import Iterable, Iterator

import msgspec

from benchmarks.figures import Figure
from benchmarks.figures import table as format_figures
from benchmarks.wheel_trial import KINEMATIC, Trial, run_trial
from tests.sim_server.description.wheel_models import WheelRobot, list_robots
from zensim.sim_server.description.motion_prediction import predict_nominal_motions

ENGINES = ("pybullet", "mujoco", KINEMATIC)
SHORT_ROBOTS = ("skid_square",)
TURN_SCALE = 0.5
"""Turn [rad/s] to which a drift is relative."""
LEAST_SHARE = 0.1
"""Share of a commanded speed; a smaller prediction counts as this."""
WITHIN = (2.0, 5.0)
"""Percent."""


class Expected(msgspec.Struct, frozen=True):
    """Speed and turn of both drives."""

    speed: float
    drift: float
    turn: float


class WheelRow(msgspec.Struct, frozen=True):
    """One robot in one engine."""

    robot: str
    engine: str
    commanded: Expected
    predicted: Expected
    measured: Expected
    creep_mm_s: float
    tilt_rad: float
    predicted_tilt_rad: float

    @property
    def off_percent(self) -> float:
        """Greatest deviation from the prediction."""
        return 100.0 * max(
            _deviation(self.measured.speed, self.predicted.speed, self.commanded.speed),
            _deviation(self.measured.turn, self.predicted.turn, self.commanded.turn),
            abs(self.measured.drift - self.predicted.drift) / TURN_SCALE,
        )

    @property
    def is_as_commanded(self) -> bool:
        """Whether friction allows the command."""
        pairs = (
            (self.predicted.speed, self.commanded.speed),
            (self.predicted.turn, self.commanded.turn),
        )
        return all(abs(found / wanted - 1.0) < 1e-3 for found, wanted in pairs)


def _deviation(measured: float, predicted: float, commanded: float) -> float:
    scale = max(abs(predicted), LEAST_SHARE * abs(commanded))
    return abs(measured - predicted) / scale


def measure_robot(robot: WheelRobot, engines: Iterable[str]) -> Iterator[WheelRow]:
    """Drive a robot in each engine."""
    straight, turn = predict_nominal_motions(robot.model())
    commanded = Expected(straight.nominal[0], 0.0, turn.nominal[2])
    predicted = Expected(straight.twist[0], straight.twist[2], turn.twist[2])
    tilt = straight.ground.rest.tilt_rad
    for engine in engines:
        is_kinematic = engine == KINEMATIC
        trial = run_trial(robot, engine)
        yield WheelRow(
            robot.name,
            engine,
            commanded,
            predicted,
            _found(trial),
            1e3 * trial.rest.creep_m_s,
            trial.rest.tilt_rad,
            0.0 if is_kinematic else tilt,
        )


def _found(trial: Trial) -> Expected:
    return Expected(trial.straight[0], trial.straight[2], trial.turning[2])


def rows(*, is_short: bool) -> Iterator[WheelRow | Figure]:
    """Measure all robots, and summarize each engine."""
    robots = [one for one in list_robots() if not is_short or one.name in SHORT_ROBOTS]
    found = [row for robot in robots for row in measure_robot(robot, ENGINES)]
    for engine in ENGINES:
        yield from _summarize(engine, [row for row in found if row.engine == engine])
    yield from found


def _summarize(engine: str, found: list[WheelRow]) -> Iterator[Figure]:
    for percent in WITHIN:
        share = sum(row.off_percent <= percent for row in found) / len(found)
        what = f"{engine}: robots within {percent:g} % of the prediction"
        yield Figure(what=what, unit="%", samples=(100.0 * share,))
    free = [row for row in found if row.is_as_commanded]
    skids = [row for row in found if row.robot.startswith("skid")]
    for what, unit, samples in (
        ("speed of robots that can: off the command", "%", [_speed_off(row) for row in free]),
        ("turn of robots that can: off the command", "%", [_turn_off(row) for row in free]),
        ("skid steering: off the prediction", "%", [row.off_percent for row in skids]),
        ("turn while driving straight", "rad/s", [abs(row.measured.drift) for row in free]),
        ("creep at rest", "mm/s", [row.creep_mm_s for row in found]),
        ("tilt at rest: off", "rad", [_tilt_off(row) for row in found]),
    ):
        if samples:
            yield Figure(what=f"{engine}: {what}", unit=unit, samples=tuple(samples))


def _speed_off(row: WheelRow) -> float:
    return 100.0 * abs(row.measured.speed / row.commanded.speed - 1.0)


def _turn_off(row: WheelRow) -> float:
    return 100.0 * abs(row.measured.turn / row.commanded.turn - 1.0)


def _tilt_off(row: WheelRow) -> float:
    return abs(row.tilt_rad - row.predicted_tilt_rad)


HEAD = "| robot | engine | commanded | predicted | measured | drift | creep | off |\n" + (
    "|---|---|---|---|---|---|---|---|\n"
)


def table(found: Iterable[WheelRow | Figure]) -> str:
    """Format the summary, then each robot; speeds in m/s, turns in rad/s, creep in mm/s."""
    listed = list(found)
    figures = format_figures(one for one in listed if isinstance(one, Figure))
    robots = "".join(_format_row(one) for one in listed if isinstance(one, WheelRow))
    return f"{figures}\nSpeed [m/s], turn and drift [rad/s], creep [mm/s].\n\n{HEAD}{robots}"


def _format_row(row: WheelRow) -> str:
    off = f"{row.off_percent:.1f} %"
    cells = (
        row.robot,
        row.engine,
        _format_pair(row.commanded),
        _format_pair(row.predicted),
        _format_pair(row.measured),
        f"{row.measured.drift:.3f}",
        f"{row.creep_mm_s:.2f}",
        off if row.off_percent <= WITHIN[0] else f"**{off}**",
    )
    return f"| {' | '.join(cells)} |\n"


def _format_pair(expected: Expected) -> str:
    return f"{expected.speed:.4f}, {expected.turn:.4f}"
