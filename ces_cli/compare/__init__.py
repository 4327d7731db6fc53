"""`ces compare`: models and other simulations on the same recordings."""
