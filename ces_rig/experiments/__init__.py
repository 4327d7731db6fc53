"""Experiments: described in YAML files (those in this folder are packaged), or designed from what is known."""
