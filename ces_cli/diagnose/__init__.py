"""The program `diagnose`: one diagnosis, or a fleet of them with `--each`."""
