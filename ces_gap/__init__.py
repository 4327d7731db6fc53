"""The gap between a simulation and recordings of the real damper: where it lies, what causes it, what remains."""
