"""Networks and neuro-fuzzy models: training data and a family of models in, parameters out, by free-run error."""
