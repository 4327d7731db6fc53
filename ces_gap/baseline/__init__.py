"""The simulation and its baseline error: references in, a plant (simulation plus correction) out.

Its twin holds what effects change inside; a generic learner shows how much any effect could explain (`ceiling`).
"""
