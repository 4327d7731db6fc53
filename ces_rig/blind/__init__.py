"""Blind cases: a plan goes in, folders with recordings, a simulation and sealed answers come out."""
