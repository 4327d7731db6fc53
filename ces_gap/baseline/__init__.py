"""The simulation and its own error: references go in, a plant (simulation plus correction) comes out.

The same generic learner replaces slow simulations (`surrogate`) and shows how much any effect could explain
(`ceiling`).
"""
