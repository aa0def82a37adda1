"""Ids of Gymnasium, as `gymnasium.make("zensim/Reach-v0")`."""

import gymnasium

ROBOTS = 4
"""Robots of a world in which several learn, unless `count` says otherwise."""
ONE = "zensim.envs.robot_env:ZensimEnv"
MANY = "zensim.envs.vector_env:ZensimVectorEnv"


def register_ids() -> None:
    """Register the tasks."""
    for name, task in (("Reach", "reach"), ("Navigate", "navigate")):
        given: dict[str, object] = {"task": task}
        gymnasium.register(f"zensim/{name}-v0", ONE, vector_entry_point=MANY, kwargs=given)
    for name, task in (("Avoid", "avoid"), ("Formation", "formation")):
        given = {"task": task, "count": ROBOTS}
        gymnasium.register(f"zensim/{name}-v0", vector_entry_point=MANY, kwargs=given)
    for name, task in (("Pursue", "pursue"), ("Cover", "cover"), ("Deliver", "deliver")):
        given = {"task": task}
        gymnasium.register(f"zensim/{name}-v0", vector_entry_point=MANY, kwargs=given)
