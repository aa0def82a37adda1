"""The MuJoCo engine: precompiled models with slots, so that robots are added and removed without recompiling."""
