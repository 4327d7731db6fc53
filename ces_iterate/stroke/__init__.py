"""Iterative learning control of the rig's actuator: the command that makes the piston follow a wanted stroke.

`plan` reads what is wanted and allowed, `rig` runs a command and returns positions, `frequency_response` and
`actuator_model` identify the actuator from runs, `learning_filter` designs the update and evaluates its robustness,
`limits` keeps every command inside the rig's limits, `learning` iterates, `result_files` and `page` show what came out.
"""
