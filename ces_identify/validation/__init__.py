"""How good a model is: a model and unseen series go in; costs, intervals, residual tests and noise floors come out."""
