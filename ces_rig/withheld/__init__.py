"""Plants for blind tests: a kind and a seed go in, a damper with withheld effects comes out."""
