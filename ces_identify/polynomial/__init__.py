"""Polynomial NARX models: candidate rules and series go in, selected terms with fitted coefficients come out.

A problem is assembled once; searches from several starts add, exchange and prune terms by free-run cost.
"""
