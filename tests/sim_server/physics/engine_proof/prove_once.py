"""`python -m tests.sim_server.physics.engine_proof.prove_once`: start with MuJoCo."""

from zensim.proto.settings.engine_settings import EngineSettings
from zensim.sim_server.physics.engine_proof.engine_prover import choose_proven_engine

if __name__ == "__main__":
    choose_proven_engine(EngineSettings(engine="mujoco"))
