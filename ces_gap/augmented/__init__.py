"""The augmented simulation: simulation, correction and composition go in, `augmented.json` comes out.

It is a simulation again: `load_augmented` reads the file back.
"""
