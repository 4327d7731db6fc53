"""Iterative learning control of the rig's actuator: the command that makes the piston follow a wanted stroke.

`plan` reads what is wanted and allowed, `rigs` run a command and return positions, `actuator` identifies the actuator
from runs, `learning_filter` designs the update and evaluates its robustness, `limits` keeps every command inside the
rig's limits, `learning` iterates, `page` shows what came out.
"""
