"""The plan of an iteration: a YAML file goes in, checked limits, stopping rules and settings come out."""
