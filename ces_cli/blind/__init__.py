"""The program `blind`: blind tests of the diagnosis are made, run and scored."""
