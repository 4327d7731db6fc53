"""Rigs: each kind is one module with a class that runs commands and returns the recording."""
