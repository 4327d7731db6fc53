"""Fast models of the plant, learnt from simulated forces: a map of speed and current, with a spring in series."""
