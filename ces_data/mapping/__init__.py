"""Proposals for what a user would have to write by hand: which topic or column holds which signal, in which unit.

Candidates with their names, units and samples go in; a proposal with its reasons comes out. What cannot be known is
said, never guessed.
"""
