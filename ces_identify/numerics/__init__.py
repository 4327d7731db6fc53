"""Numerical kernels without knowledge of files or models: arrays go in, arrays come out."""
