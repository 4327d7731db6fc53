"""The program `rig`: runs an experiment on the virtual rig and records it."""
