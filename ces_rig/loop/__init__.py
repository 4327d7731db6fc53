"""The loop: design, run, score, identify, until a target or a budget is reached; every iteration is kept."""
