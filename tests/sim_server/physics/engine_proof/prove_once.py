"""`python -m tests.sim_server.physics.engine_proof.prove_once`: start with MuJoCo."""

from zensim.sim_server.physics.engine_config import EngineOptions
from zensim.sim_server.physics.engine_proof.engine_prover import choose_proven_engine

if __name__ == "__main__":
    choose_proven_engine(EngineOptions(engine="mujoco"))
