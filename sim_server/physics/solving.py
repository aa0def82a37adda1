"""How exactly Bullet solves for forces: what robots need to drive straight, and to stand still."""

from typing import Final, TypedDict

SOLVER_ITERATIONS = 20
"""At most. 10 cost 0.87 of this, and a box_bot that has stopped goes on rocking; 50 cost 1.5."""

SOLVED = 3e-7
"""Square of the greatest change of a speed [m/s] in an iteration after which the solver stops.

The usual 1e-7 costs 1.1 of this; 1e-5 would cost 0.85, and ten times the sideways drift.
"""


class Solving(TypedDict):
    """Arguments of setPhysicsEngineParameter."""

    numSolverIterations: int
    solverResidualThreshold: float
    minimumSolverIslandSize: int
    enableConeFriction: int
    enableFileCaching: int


SOLVING: Final[Solving] = {
    "numSolverIterations": SOLVER_ITERATIONS,
    "solverResidualThreshold": SOLVED,
    # One that is solved need not go on with others that are not.
    "minimumSolverIslandSize": 1,
    "enableConeFriction": 0,
    # Of another mesh at the same path it would go on with the first.
    "enableFileCaching": 0,
}
