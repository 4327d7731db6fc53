"""The hydraulic CES damper: chambers, valves, pilot stage, seal, mount and heat."""
