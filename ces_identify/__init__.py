"""Offline identification: recordings go in; selected, validated and proved models come out. Needs no ROS.

The rooms in reading order: `limits` (the numbers that decide), `prepare` (uniform ticks), `numerics` (kernels and
searches), `polynomial`, `training` and `physical` (what fits need), `structures` (a fit and a kit each), `simulations`
(anything that computes a force), `validation` (how good a model is), `comparison` (several models on the same
recordings), `export` (C, FMU, C++), `report` (the page), `characteristics` (what a damper dyno shows), `campaign` (many
identifications) on `jobs` (many jobs at once).
"""
