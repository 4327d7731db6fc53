"""Design of experiments: limits and what is known go in, stroke and current of the next experiment come out."""
