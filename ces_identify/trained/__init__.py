"""Networks and neuro-fuzzy models: training data and a family of models go in, parameters come out.

All parameters are fitted together to the free-run error, with a penalty that keeps the model a contraction.
"""
