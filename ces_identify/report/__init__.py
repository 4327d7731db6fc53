"""The report: a model and its evaluations go in, one self-contained HTML page for screen and print comes out."""
