"""Blind tests' plants and the effects withheld from their simulations, in the rig's own physical form."""
