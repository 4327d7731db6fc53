"""Structures that are fitted as a whole: series and a shape go in, networks or neuro-fuzzy rules come out.

All parameters are fitted together to the free-run error, with a penalty that keeps the model a contraction.
"""
