"""Polynomial NARX models: candidate rules and series in, selected terms with fitted coefficients out.

A problem is assembled once; searches from several starts add, exchange and prune terms by free-run cost.
"""
