"""Numerical kernels without files or models: arrays in, arrays out."""
