"""The simulation and its baseline error: references in, a plant (simulation plus correction) out.

The same generic learner replaces slow simulations (`surrogate`) and shows how much any effect could explain
(`ceiling`).
"""
