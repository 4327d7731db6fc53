"""The program `rig`: an experiment on the virtual rig becomes a recording."""
